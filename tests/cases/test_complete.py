"""Each input of tests/data/cases has a test."""

from pathlib import Path

HERE = Path(__file__).parent
INPUTS = HERE.parent / "data" / "cases"


def test_every_input_has_a_test():
    tests = "".join(
        path.read_text() for path in HERE.glob("test_*.py") if path.name != "test_complete.py"
    )
    data = {path for path in INPUTS.iterdir() if path.suffix in {".toml", ".json", ".py"}}
    assert sorted(path.name for path in data if f'"{path.stem}' not in tests) == []
