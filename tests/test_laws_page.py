"""The tables of the comparison of laws; `make docs` computes their figures anew."""

import json
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tools"))

import laws_page  # noqa: E402


@pytest.mark.parametrize("section", laws_page.SECTIONS, ids=lambda section: section.name)
def test_the_page_has_the_gains_and_figures_that_the_search_wrote(section):
    page = laws_page.PAGE.read_text("utf-8")
    found = [json.loads((ROOT / gains).read_text("utf-8")) for gains in section.files]
    old, new = laws_page.section_of(page, section), laws_page.written(section, found)
    assert not laws_page.differences(old, new)
    for gains in section.files:
        assert f"`{' '.join(section.command(gains))}`" in page


def test_a_changed_number_is_seen():
    line = "| lean | 0.0123 | **4.56** | c = [1, 2] |"
    assert not laws_page.differences(line, line.replace("0.0123", "0.0124"))
    for other in (
        line.replace("0.0123", "0.0223"),
        line.replace("**4.56**", "4.56"),
        line.replace("[1, 2]", "[1, 3]"),
        line.replace("lean", "lqr"),
        line + "\n" + line,
    ):
        assert laws_page.differences(line, other)
