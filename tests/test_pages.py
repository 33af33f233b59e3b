"""Pages about the repository itself: examples of style, decisions, versions."""

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
RECORDS = sorted((ROOT / "docs" / "decisions").glob("*.md"))


def unlaid(code):
    """Code without its layout: line breaks, indentation, strings in several parts."""
    return re.sub(r"\s+", "", re.sub(r'"\s*\n\s*f?"', "", code))


def test_examples_of_style_stand_in_the_code():
    page = (ROOT / "CONTRIBUTING.md").read_text()
    examples = re.findall(r"`([\w/]+\.py)`[^`]*:\n\n```py\n(.*?)^```", page, re.M | re.S)
    assert len(examples) == page.count("```py\n") > 3
    for file, text in examples:
        assert unlaid(text) in unlaid((ROOT / "src" / "certrack" / file).read_text()), file


def test_every_decision_is_listed_and_has_its_parts():
    page = (ROOT / "docs" / "decisions.md").read_text()
    listed = re.findall(r"^\| (\d+) \| \[(.+)\]\((.+)\) \|", page, re.M)
    assert [target for _, _, target in listed] == [f"decisions/{path.name}" for path in RECORDS]
    parts = ["Context", "Decision", "What was measured", "Consequences", "Left out"]
    for (number, title, _), path in zip(listed, RECORDS, strict=True):
        text = path.read_text()
        assert path.name.startswith(f"{int(number):04}-")
        head = rf"# {number}\. {re.escape(title)}\n\nStatus: [^.\n]+\. Date: \d{{4}}-\d\d-\d\d\.\n"
        assert re.match(head, text), path
        assert re.findall(r"^## (.+)", text, re.M) == parts


def test_versions_agree():
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    citation = (ROOT / "CITATION.cff").read_text()
    assert re.findall(r"^version: (.+)", citation, re.M) == [version]
    changes = (ROOT / "CHANGELOG.md").read_text()
    numbers = re.findall(r"^## \[(\d.*?)\] - \d{4}-\d\d-\d\d$", changes, re.M)
    assert numbers[0] == version
    assert numbers == sorted(set(numbers), key=lambda n: [*map(int, n.split("."))], reverse=True)
