"""Polyline encoding: Google's own example, and invalid texts."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.core.base.errors import LeewayError
from companion.fleet.polyline import decode_polyline, encode_polyline

EXAMPLE = ((38.5, -120.2), (40.7, -120.95), (43.252, -126.453))
EXAMPLE_TEXT = "_p~iF~ps|U_ulLnnqC_mqNvxq`@"
"""Of the format's own page ("Encoded Polyline Algorithm Format", Google Maps Platform)."""

places = st.tuples(st.floats(-90.0, 90.0), st.floats(-180.0, 180.0))


def test_the_formats_own_example_is_written_and_read():
    assert encode_polyline(EXAMPLE) == EXAMPLE_TEXT
    assert decode_polyline(EXAMPLE_TEXT) == EXAMPLE
    assert encode_polyline(()) == ""
    assert decode_polyline("") == ()


@given(st.lists(places, max_size=60))
def test_a_way_comes_back_within_half_a_step(way: list[tuple[float, float]]):
    for there, back in zip(way, decode_polyline(encode_polyline(way)), strict=True):
        assert back == pytest.approx(there, abs=0.500001e-5)


@given(st.text(alphabet=st.characters(min_codepoint=63, max_codepoint=126), max_size=80))
def test_any_text_is_a_way_on_earth_or_refused(text: str):
    try:
        found = decode_polyline(text)
    except LeewayError:
        return  # no other exception is raised
    assert all(abs(lat) <= 90.0 and abs(lon) <= 180.0 for lat, lon in found)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("_p~iF", "without its longitude"),
        ("_", "truncated"),
        ("_p~iF~ps|U_", "truncated"),
        (">?", "invalid character"),
        ("~" * 9, "invalid character"),
        ("_ye~O?_ye~O?", "is not a valid position"),
    ],
)
def test_what_is_no_way_is_refused(text: str, words: str):
    with pytest.raises(LeewayError, match=words):
        decode_polyline(text)
