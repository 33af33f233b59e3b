"""The dossier: complete, the same numbers as the commands, nothing from outside, the same bytes."""

import base64
import hashlib
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest
from click.testing import CliRunner
from conftest import SHIPPED

import certrack
from certrack.cli import cli
from certrack.core.errors import InputError
from certrack.reports import guarantee as guarantee_module
from certrack.reports import pages
from certrack.reports.certificates import certificates_table
from certrack.reports.dossier import dossier_of
from certrack.reports.evidence import OPTIONAL, evidence_of
from certrack.reports.formula_pictures import broken, formula_svgs
from certrack.reports.guarantee import guarantee_section
from certrack.reports.pages import to_html, to_latex, to_markdown
from certrack.reports.system_sections import plant_section
from certrack.studies.falsifier.drive import DriveFalsification
from certrack.studies.falsifier.falsify import Falsification

CASES = Path(__file__).parent / "data" / "cases"
SLOW_PARTS = [word for name in OPTIONAL for word in ("--without", name)]


class Page(HTMLParser):
    """What a page loads, links to and shows."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.addresses, self.cells, self.open = [], [], [], []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.addresses += [v for k, v in attributes if k in ("src", "href", "action", "srcset")]
        if tag not in ("meta", "img"):
            self.open.append(tag)
        if tag in ("td", "th"):
            self.cells.append("")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag, "tags are nested"

    def handle_data(self, data):
        if self.open and self.open[-1] in ("td", "th"):
            self.cells[-1] += data


@pytest.fixture(scope="module")
def found():
    return evidence_of(
        certrack.load("dual-motor-drive"), "drive.toml", effort="fast", without=OPTIONAL
    )


@pytest.fixture(scope="module")
def page(found):
    return to_html(dossier_of(found))


def test_a_page_loads_nothing_and_runs_nothing(page):
    shown = Page(page)
    assert not shown.open
    assert not {"script", "iframe", "object", "embed", "link", "form"} & set(shown.tags)
    assert all(address.startswith(("data:", "#")) for address in shown.addresses)
    assert not re.search(r"\son\w+\s*=|url\(|@import", re.sub(r'"data:[^"]*"', "", page))
    assert shown.tags.count("img") >= 8  # formulas, tube, starts, response


def test_numbers_are_those_of_the_command_line(found, page, monkeypatch):
    monkeypatch.setenv("COLUMNS", "300")
    cells = Page(page).cells
    for row in certificates_table(found.certificates).rows:
        assert set(row) <= set(cells)
    printed = CliRunner().invoke(cli, ["certify", "dual-motor-drive", "--effort", "fast"]).output
    bounds = set(re.findall(r"│ +(0\.\d+) +│", printed))
    assert len(bounds) >= 3
    assert bounds <= set(cells)


def test_the_budget_of_the_error_adds_up(found):
    (budget,) = [
        t for t in guarantee_section(found).tables if t.columns == ("cause", "adds", "of it")
    ]
    total = sum(float(row[1]) for row in budget.rows)
    assert total == pytest.approx(found.certificates.implemented.bound, rel=5e-3)
    assert [row[0] for row in budget.rows[:2]] == ["reference", "sensors"]


def test_what_it_carries_can_be_checked(found, tmp_path):
    carried = {
        file.name: file for section in dossier_of(found).sections for file in section.attachments
    }
    for file in carried.values():
        assert hashlib.sha256(file.content.encode()).hexdigest() == file.sha256
        (tmp_path / file.name).write_text(file.content)
    assert certrack.load(tmp_path / "system.toml") == found.system
    verdict = certrack.certificates.verify(tmp_path / "certificate.json")
    assert verdict.verified
    assert float(verdict.bound) <= found.certificates.best.bound


def test_attachments_are_in_the_page(page):
    link = re.search(
        r'download="certificate.json" href="data:application/json;base64,([^"]+)"', page
    )
    assert json.loads(base64.b64decode(link[1]))["proof"]


def test_a_long_certificate_is_named_by_its_digest(found, monkeypatch):
    monkeypatch.setattr(guarantee_module, "LONGEST_ATTACHMENT", 10)
    (file,) = guarantee_section(found).attachments
    assert file.content == "" and len(file.sha256) == 64
    assert "too long to be carried" in to_html(dossier_of(found))


@pytest.mark.slow
def test_two_are_the_same_bytes(found, page):
    again = evidence_of(found.system, "drive.toml", effort="fast", without=OPTIONAL)
    assert to_html(dossier_of(again)) == page


@pytest.mark.parametrize("wrong", [{"budget": 0}, {"seed": -1}, {"members": 0}])
def test_an_argument_of_another_kind_is_refused(found, wrong):
    (name,) = wrong
    with pytest.raises(InputError, match=name):
        evidence_of(found.system, "drive.toml", effort="fast", without=OPTIONAL, **wrong)


def test_words_of_a_file_are_text(found):
    system = found.system.replace(title='<script>alert("1")</script> & $x$')
    text = to_html(dossier_of(replace(found, system=system)))
    assert "<script" not in text
    assert "&lt;script&gt;" in text


def test_tables_for_papers(found):
    made = dossier_of(found)
    text = to_markdown(made)
    widths = {row.count(" | ") for row in text.splitlines() if row.startswith("| semidefinite")}
    assert widths == {3}
    assert text.startswith(f"# {found.system.title}\n")
    latex = to_latex(made)
    assert latex.count(r"\begin{tabular}") == sum(len(section.tables) for section in made.sections)
    assert latex.count("{") == latex.count("}")


def test_a_refused_part_says_why(found):
    made = dossier_of(replace(found, refusals={"falsification": "no law", "margins": "no edge"}))
    lines = {section.key: section.lines for section in made.sections}
    assert lines["falsification"] == ("not computed: no law",)
    assert lines["margins"] == ("not computed: no edge",)
    assert "ensemble" not in lines  # left out


@pytest.mark.slow
def test_all_parts(tmp_path):
    made = certrack.dossier(certrack.load("example1"), "example1", members=20, budget=100)
    assert [section.key for section in made.sections] == [
        *("plant", "law", "premises", "guarantee", "response"),
        *("falsification", "ensemble", "margins", "file"),
    ]
    assert made.verified and made.sound
    assert len(made.summary) == 4
    certrack.save_dossier(made, tmp_path / "report.html")
    assert (tmp_path / "report.html").stat().st_size < 3e6
    assert "probability within" in (tmp_path / "report.html").read_text()


def test_a_contradicted_premise_is_at_the_top(tmp_path):
    out = tmp_path / "report.html"
    file = str(CASES / "robust-wrong-gain.toml")
    run = CliRunner().invoke(cli, ["report", file, "--out", str(out), *SLOW_PARTS])
    assert run.exit_code == 1
    assert "nothing is verified for this file" in run.output
    text = out.read_text()
    assert 'class="summary unverified"' in text
    assert text.index("contradicts a premise") < text.index("<nav")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("report.docx", "must end with one of .html, .pdf, .md, .tex"),
        ("report", "must end with one of"),
        ("none/report.html", "report.html"),
    ],
)
def test_what_cannot_be_written_is_refused_at_once(tmp_path, monkeypatch, name, message):
    monkeypatch.setattr("certrack.reports.dossier.evidence_of", None)  # nothing may be computed
    with pytest.raises(certrack.InputError, match=re.escape(message)):
        CliRunner().invoke(
            cli,
            ["report", "example1", "--out", str(tmp_path / name)],
            catch_exceptions=False,
            standalone_mode=False,
        )


@pytest.mark.parametrize(("name", "package"), [("a.html", "jinja2"), ("a.pdf", "weasyprint")])
def test_a_missing_package_is_named(tmp_path, monkeypatch, name, package):
    monkeypatch.setitem(__import__("sys").modules, package, None)
    with pytest.raises(certrack.MissingExtra, match=r"certrack\[report\]"):
        pages.require_writable(tmp_path / name)


def test_a_print(found, tmp_path):
    try:
        pages.require_writable(tmp_path / "report.pdf")
    except certrack.MissingExtra:
        pytest.skip("no WeasyPrint, or no Pango")
    certrack.save_dossier(dossier_of(found), tmp_path / "report.pdf")
    data = (tmp_path / "report.pdf").read_bytes()
    assert data.startswith(b"%PDF") and len(data) < 3e6


def test_a_bound_of_the_continuous_law_says_so_where_there_is_a_drive(found):
    certificates = replace(
        found.certificates, implemented=replace(found.certificates.implemented, verified=False)
    )
    assert "as the drive runs it, from x0" in dossier_of(found).summary[0]
    first = dossier_of(replace(found, certificates=certificates)).summary[0]
    assert "of the continuous law; nothing is verified of the loop as the drive runs it" in first


def test_the_worst_case_of_the_summary_is_of_the_loop_of_its_bound(found):
    bounds, implemented = {"peak": found.certificates.peak}, found.certificates.implemented
    calm = Falsification(2e-3, found.system, 100, bounds, None, None, "", own_run=False)
    drive = DriveFalsification(1e-3, None, found.system, None, implemented)
    of_drive = "of the loop as the drive runs it"

    def line(found):
        return next(text for text in dossier_of(found).summary if "worst admissible" in text)

    def with_drive(drive, **more):
        return line(replace(found, falsification=replace(calm, drive=drive, **more)))

    assert found.certificates.best is implemented
    assert with_drive(drive) == f"worst admissible case found, {of_drive}: 0.001"
    assert "the bound is not for it" in with_drive(replace(drive, worst_error=9.0, limited=True))
    left_out = {"drive": "the loop is not linear"}
    said = f"no worst admissible case was found {of_drive}: the loop is not linear"
    assert with_drive(None, left_out=left_out) == said
    continuous = replace(found.certificates, implemented=replace(implemented, verified=False))
    both = replace(calm, drive=drive)
    shown = line(replace(found, certificates=continuous, falsification=both))
    assert shown == "worst admissible case found, of the continuous law: 0.002"


def test_an_alarm_stands_at_the_top_and_is_not_sound(found):
    bounds = {"peak": found.certificates.peak}
    calm = Falsification(1e-4, found.system, 100, bounds, None, None, "", own_run=False)
    made = dossier_of(replace(found, falsification=calm))
    assert made.verified and made.sound
    loud = replace(calm, alarm="defect", reason="it is wrong")
    made = dossier_of(replace(found, falsification=loud))
    assert made.summary[1] == "ALARM: a run is beyond the verified bound: it is wrong"
    assert not made.verified and not made.sound


def test_quoted_commands_repeat_what_was_computed(found):
    text = to_markdown(dossier_of(replace(found, effort="fast", file="my drive.toml")))
    quoted = "certrack certify 'my drive.toml' --effort fast --out certificate.json"
    assert quoted in text
    other = replace(found, budget=500, seed=3)
    assert other.command("falsify") == "certrack falsify drive.toml --budget 500 --seed 3"
    plain = replace(found, effort="default")
    assert plain.command("certify") == "certrack certify drive.toml"
    assert plain.command("falsify") == "certrack falsify drive.toml"


def test_what_has_no_controller_in_c_says_why(found):
    made = dossier_of(replace(found, code=None, refusals={"code": "no code of it"}))
    (drive,) = [section for section in made.sections if section.key == "drive"]
    assert drive.lines == ("no controller in C: no code of it",)


@pytest.mark.parametrize("wrong", [{"budget": 0}, {"seed": -1}, {"members": 0}])
def test_wrong_arguments_are_refused_at_once(found, monkeypatch, wrong):
    monkeypatch.setattr("certrack.reports.evidence.certify", None)  # nothing may be computed
    with pytest.raises(certrack.InputError, match=next(iter(wrong))):
        evidence_of(found.system, **wrong)


def test_markdown_shows_words_of_a_file_as_they_are(found):
    system = found.system.replace(title="<b>a</b> *b* `c` [d](e) _f_ g_1 | h")
    first = to_markdown(dossier_of(replace(found, system=system))).splitlines()[0]
    assert first == r"# \<b>a\</b> \*b\* \`c\` \[d\](e) \_f\_ g_1 \| h"


def test_formulas_are_broken_between_terms():
    latex = r"\nu = " + " + ".join(rf"{k} x_{{{k}}} \left(a - b\right)" for k in range(30))
    lines = broken(latex)
    assert len(lines) > 2
    joined = " ".join(line.removeprefix(r"\quad ") for line in lines)
    assert joined.split() == latex.split()
    assert all(line.count("(") == line.count(")") for line in lines)
    assert len(formula_svgs(latex)) == len(lines)
    assert formula_svgs(latex) == formula_svgs(latex)


@pytest.mark.slow
@pytest.mark.parametrize("name", SHIPPED)
def test_every_shipped_system_has_one(name):
    few = {"effort": "fast", "members": 12, "budget": 100}
    slow = ("margins",) * (name == "stiction")  # it sticks anew in most samples: minutes
    made = certrack.dossier(certrack.load(name), name, without=slow, **few)
    assert len(to_html(made)) < 3e6
    assert Page(to_html(made)).tags.count("section") == len(made.sections)


def test_names_of_several_letters_stay_apart_and_zero_terms_are_left_out(found):
    section = plant_section(replace(found, system=certrack.load("motor-shaft-load")))
    formula = section.formulas[-1].latex
    assert formula.startswith(r"\dot{\mathrm{rate}} = 1250 \, u")
    assert r"K \, \mathrm{twist}" in formula and formula_svgs(formula)
    terms = next(entry for entry in section.tables if entry.title.startswith("uncertain"))
    assert [row[2] for row in terms.rows] == ["Delta |x|", "12.5"]
    section = plant_section(replace(found, system=certrack.load("example1")))
    terms = next(entry for entry in section.tables if entry.title.startswith("uncertain"))
    assert [row[2] for row in terms.rows] == ["0.5 ||x||", "0.2 ||x|| + 0.1"]


def test_starts_that_one_state_varies_are_not_drawn(found):
    results = found.certificates
    polytope = results.implemented.polytope
    keys = [picture.name for picture in guarantee_section(found).pictures]
    assert "starts" in keys
    flat = replace(
        polytope, region=(polytope.region[0], *[(0.0, 0.0)] * (len(polytope.region) - 1))
    )
    narrow = replace(results, implemented=replace(results.implemented, polytope=flat))
    pictures = guarantee_section(replace(found, certificates=narrow)).pictures
    assert [picture.name for picture in pictures] == [key for key in keys if key != "starts"]
