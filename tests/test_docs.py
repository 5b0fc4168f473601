"""The text is true: its code runs, its links lead somewhere, its names exist, every public name is listed."""

import importlib
import re
import sys
from pathlib import Path

import pytest

import eladapt as ea

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
sys.path.insert(0, str(DOCS))

from blocks import BlockError, blocks, run  # noqa: E402
from links import faults  # noqa: E402

PAGES = sorted([*DOCS.rglob("*.md"), *ROOT.glob("*.md"), ROOT / "examples" / "README.md"])
LINK = re.compile(r"\]\(([^)#\s]+)(?:#[^)\s]*)?\)")
CODE = re.compile(r"^```.*?^```$|`[^`\n]+`", re.M | re.S)


def named(page: Path) -> str:
    return str(page.relative_to(ROOT))


@pytest.mark.slow
def test_the_code_of_the_readme_runs(tmp_path):
    """As a reader would run it, block after block; that of the site runs when the site is built."""
    run(ROOT / "README.md", tmp_path)


@pytest.mark.parametrize("page", PAGES, ids=named)
def test_code_that_is_not_run_says_why(page):
    for block in blocks(page):
        assert not block.why or len(block.why) > 5, f"{named(page)}:{block.line}"
        assert "pip install eladapt" not in block.code, "no such package is published"
        assert not re.search(r"pip install \"?eladapt", block.code)


def test_a_block_that_raises_is_named_by_page_and_line(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("# A page\n\n```python\nx = 1\n```\n\n```python\nx = 2\nprint(y)\n```\n")
    with pytest.raises(BlockError, match=r"page\.md:8: this block raises NameError: name 'y'"):
        run(page, tmp_path)


def test_blocks_share_names_and_folder_and_say_what_they_print_and_write(tmp_path):
    page = tmp_path / "page.md"
    (tmp_path / "out").mkdir()
    page.write_text(
        "```python\nx = 3\n```\n\n<!-- not run: needs a robot -->\n```python\nraise SystemExit\n```\n\n"
        "```python\nprint(x)\nopen('a.txt', 'w').write('1')\n```\n\n```sh\ncat a.txt\n```\n"
    )
    outcomes = run(page, tmp_path / "out")
    assert [outcome.printed for outcome in outcomes] == ["", "", "3\n", "1"]
    assert [outcome.files for outcome in outcomes] == [[], [], ["a.txt"], []]


def test_a_block_that_is_indented_is_refused(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("- a list\n\n    ```python\n    x = 1\n    ```\n")
    with pytest.raises(BlockError, match=r"page\.md:3: .* begin it in column 1"):
        blocks(page)


@pytest.mark.parametrize("page", PAGES, ids=named)
def test_links_lead_to_files(page):
    """As the repository shows them; a page that the site alone has is none."""
    text = CODE.sub("", page.read_text("utf-8"))
    targets = [target for target in LINK.findall(text) if ":" not in target]
    missing = [target for target in targets if not (page.parent / target).exists()]
    assert not missing, f"{named(page)}: {missing}"


@pytest.mark.parametrize("page", PAGES, ids=named)
def test_names_in_the_text_exist(page):
    """`ea.name` and `eladapt.module.name` in the text and its code are there."""
    text = page.read_text("utf-8")
    for path in sorted({f"eladapt.{found}" for found in re.findall(r"\bea\.([A-Za-z]\w*)", text)}):
        assert hasattr(ea, path.split(".")[1]), f"{named(page)}: {path}"
    for path in sorted(set(re.findall(r"`(eladapt\.[a-z_]+(?:\.\w+)*)`", text))):
        parts = path.split(".")
        value = ea
        for k, part in enumerate(parts[1:], 2):
            value = getattr(value, part, None) or importlib.import_module(".".join(parts[:k]))


def test_the_api_has_every_public_name_once():
    listed = [
        name
        for page in (DOCS / "api").glob("*.md")
        for name in re.findall(r"^::: eladapt\.(\w+)$", page.read_text("utf-8"), re.M)
    ]
    assert sorted(listed) == sorted(ea.__all__)
    index = (DOCS / "api" / "index.md").read_text("utf-8")
    assert sorted(re.findall(r"\[`\w+`\]\[eladapt\.(\w+)\]", index)) == sorted(ea.__all__)


def test_every_table_is_linked():
    text = (DOCS / "benchmarks" / "index.md").read_text("utf-8")
    missing = [
        p.name for p in (ROOT / "benchmarks" / "results").glob("*.md") if f"results/{p.name})" not in text
    ]
    assert not missing


def test_the_readme_fits_on_two_screens():
    """Some 100 lines; a picture of its own height counts for fifteen."""
    lines = (ROOT / "README.md").read_text("utf-8").splitlines()
    assert len(lines) + 15 * sum(line.startswith("![") for line in lines) <= 115
    assert max(map(len, lines)) <= 200


def test_a_site_is_searched_for_links_that_lead_nowhere(tmp_path):
    (tmp_path / "a.html").write_text(
        '<a href="b.html">1</a> <a href="b.html#here">2</a> <a href="https://elsewhere.org/c">3</a>'
        '<a href="c.html">4</a> <a href="b.html#there">5</a> <a href="#top">6</a>'
        '<script src="https://elsewhere.org/code.js"></script>'
    )
    (tmp_path / "b.html").write_text('<h1 id="here">B</h1>')
    assert list(faults(tmp_path)) == [
        "a.html: fetches https://elsewhere.org/code.js",
        "a.html: c.html leads to no file",
        "a.html: b.html#there leads to no place in its page",
        "a.html: #top leads to no place in its page",
    ]
