"""The tool reads its options, and draws no mutant where none is requested."""

import pytest

from tests.mutants import __main__ as mutants

FILES = {
    "companion/core/base/errors.py": "def f():\n    return 1",
    "tests/test_drawn_sample.py": "from companion.core.base.errors import f",
    "journal": '{"mutant": "companion/core/base/errors.py:2:11 2", "detected": true}',
}


@pytest.mark.parametrize(("count", "output"), [("0", "no mutant"), ("1", "detected companion")])
def test_as_many_mutants_are_drawn_as_requested(tmp_path, monkeypatch, capsys, count, output):
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    options = ["--count", count, "--seed", "1", "--journal", str(tmp_path / "journal")]
    monkeypatch.setattr("sys.argv", ["mutants", *options])
    monkeypatch.setattr(mutants, "ROOT", tmp_path)
    monkeypatch.setattr(mutants, "_git", lambda *words: None)
    mutants.main()
    assert capsys.readouterr().out.startswith(output)
