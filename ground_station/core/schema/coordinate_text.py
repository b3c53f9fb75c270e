"""Coordinates as people write them: degrees with hemisphere, degrees and minutes, pairs, WKT."""

import re
from collections.abc import Callable

_NUMBER = r"\d+(?:\.\d+)?"
_ANGLE = re.compile(
    rf"""\s*(?P<sign>[+-])?(?P<before>[A-Z])?\s*(?P<degrees>{_NUMBER})
    (?:\s*[°d:\s]\s*(?:(?P<minutes>{_NUMBER})
    \s*(?:['′’m:\s]\s*(?:(?P<seconds>{_NUMBER})\s*(?:["″”s]|'')?)?)?)?)?
    \s*(?P<after>[A-Z])?\s*""",
    re.IGNORECASE | re.VERBOSE,
)
_WKT_POINT = re.compile(r"\s*POINT\s*\(\s*(\S+)\s+(\S+)\s*\)\s*", re.IGNORECASE)
_PAIRS = (
    re.compile(r"\s*(?P<lat>[+-]?\d+,\d+)\s*[,;/\s]\s*(?P<lon>[+-]?\d+,\d+)\s*"),
    re.compile(
        r"\s*(?P<lat>[^NS]+[NS]|[NS][^NSEW]+)[\s,;/]+(?P<lon>[^NSEW]+[EW]|[EW][^NSEW]+)\s*",
        re.IGNORECASE,
    ),
    re.compile(r"[\s(\[]*(?P<lat>[^,;/]+?)\s*[,;/]\s*(?P<lon>[^,;/]+?)[\s)\]]*"),
    re.compile(r"\s*(?P<lat>[+-]?\d+\.\d+)\s*[\s:]\s*(?P<lon>[+-]?\d+\.\d+)\s*"),
)
"""With decimal commas, with hemispheres, with a separator, with a space or a colon."""


def degrees_text(text: str, hemispheres: str) -> str:
    """Return decimal degrees of `55°28.2'N`, `N 55 28 12` or `55.47 N`; other text unchanged.

    `hemispheres`: the positive and the negative one, `NS` or `EW`.
    """
    found = _ANGLE.fullmatch(text)
    if found is None:
        return text
    letters = [letter.upper() for letter in (found["before"], found["after"]) if letter]
    minutes, seconds = (float(part or 0.0) for part in found.group("minutes", "seconds"))
    is_ambiguous = len(letters) > 1 or bool(letters and found["sign"])
    is_fraction_twice = found["minutes"] is not None and "." in found["degrees"]
    if (
        is_ambiguous
        or is_fraction_twice
        or max(minutes, seconds) >= 60.0
        or any(letter not in hemispheres for letter in letters)
    ):
        return text
    if not letters and found["minutes"] is None:
        return text.replace("°", "")
    value = float(found["degrees"]) + minutes / 60.0 + seconds / 3600.0
    is_negative = found["sign"] == "-" or letters == [hemispheres[1]]
    return f"{-value if is_negative else value:.9g}"


def split_lat_lon(text: str, with_decimal_point: Callable[[str], str]) -> tuple[str, str]:
    """Return latitude and longitude of one cell; WKT has the longitude first.

    Other text is returned as both, for its error.
    """
    if wkt := _WKT_POINT.fullmatch(text):
        return wkt[2], wkt[1]
    pair = next((found for one in _PAIRS if (found := one.fullmatch(text))), None)
    if pair is None:
        return text, text
    if "," in pair["lat"]:
        return pair["lat"].replace(",", "."), pair["lon"].replace(",", ".")
    lat, lon = map(with_decimal_point, pair.group("lat", "lon"))
    return degrees_text(lat, "NS"), degrees_text(lon, "EW")
