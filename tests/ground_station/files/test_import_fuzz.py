"""Damaged files of the import corpus: each is read, or refused in words for people."""

import json
import re
from functools import partial
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from companion.core.base.errors import LeewayError
from tests.ground_station.files.small_files import RESULT, orders_result
from tests.ground_station.files.test_import_corpus import CORPUS, Case

EXAMPLES_IN_CI, EXAMPLES_AT_NIGHT = 300, 30_000
TOKENS = (
    *(b"nan", b"Infinity", b"-1e999", b"1e308", b"9" * 400, b"-0", b"", b"null", b"true"),
    *(b"[]", b"{}", b'"', b"\\u202e", b"\xff\xfe", b"\0", b",", b";", b"\r", b"\xc2", b"[" * 300),
)
PYTHON_WORDS = re.compile(r"\w+Error\(|Traceback|object at 0x|\bNoneType\b|<class|positional arg")


def as_bytes(case: Case) -> bytes | None:
    content = case.content[1] if isinstance(case.content, tuple) else case.content
    if isinstance(content, dict):
        content = json.dumps(content)
    return content.encode() if isinstance(content, str) else None if callable(content) else content


FILES = [(case.kind, raw) for case in CORPUS if (raw := as_bytes(case))]
CHANGES = st.lists(
    st.tuples(
        st.sampled_from(("cut", "flip", "insert", "repeat", "value")),
        st.floats(0.0, 1.0, exclude_max=True),
        st.integers(1, 60),
        st.sampled_from(TOKENS),
    ),
    min_size=1,
    max_size=4,
)


def changed(raw: bytes, changes: list[tuple[str, float, int, bytes]]) -> bytes:
    """Return the file with each change in order."""
    for kind, place, size, token in changes:
        at = int(place * len(raw))
        match kind:
            case "cut":
                raw = raw[:at] + raw[at + size :]
            case "flip":
                raw = (
                    raw[:at]
                    + bytes(one ^ 1 << (size % 8) for one in raw[at : at + 1])
                    + raw[at + 1 :]
                )
            case "insert":
                raw = raw[:at] + token + raw[at:]
            case "repeat":
                raw = raw[: at + size] + raw[at:]
            case _:
                numbers = list(re.finditer(rb"-?\d+(?:\.\d+)?", raw))
                if numbers:
                    number = numbers[int(place * len(numbers))]
                    raw = raw[: number.start()] + token + raw[number.end() :]
    return raw


def check_read_or_refused(folder: Path, kind: str, raw: bytes) -> None:
    path = folder / "file"
    path.write_bytes(raw)
    read = RESULT.get(kind) or partial(orders_result, columns=None)
    try:
        result = read(path)
    except LeewayError as error:
        words = str(error)
    else:
        words = "read"
        assert kind in ("zones", "orders") or not re.search(r"\b(nan|inf)\b", result), result
    assert words.strip()
    assert not PYTHON_WORDS.search(words), words


@pytest.mark.parametrize(
    "examples", [EXAMPLES_IN_CI, pytest.param(EXAMPLES_AT_NIGHT, marks=pytest.mark.night)]
)
def test_a_damaged_file_is_read_or_refused_in_words(tmp_path: Path, examples: int) -> None:
    @settings(
        max_examples=examples,
        deadline=None,
        database=None,
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.large_base_example],
    )
    @given(st.sampled_from(FILES), CHANGES)
    def check(file: tuple[str, bytes], changes: list[tuple[str, float, int, bytes]]) -> None:
        check_read_or_refused(tmp_path, file[0], changed(file[1], changes))

    check()


def test_a_reader_that_raises_another_error_fails_the_check(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setitem(RESULT, "plan", lambda path: {}[path.name])
    with pytest.raises(KeyError):
        check_read_or_refused(tmp_path, "plan", b"{}")
