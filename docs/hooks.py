"""What MkDocs does beside rendering: runs the pages' code, takes in what stands elsewhere, sets equations.

- Blocks of python and sh are run when the site is built (see blocks.py); what they print, draw and write
  stands below them. While one writes, SITE_WITHOUT_CODE=1 leaves that out.
- The tables of benchmarks/results, the examples, the changelog and the like are pages too. A link to a file
  of the repository leads to its page, so the same link serves in the repository and on the site.
- Equations become MathML, which browsers draw without a script.
"""

from __future__ import annotations

import os
import re
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File

sys.path.insert(0, str(Path(__file__).parent))
from blocks import Block, BlockError, Outcome, blocks, run
from links import faults

ROOT = Path(__file__).resolve().parents[1]
LINK = re.compile(r"(?P<before>\]\()(?P<target>[^)#\s:]+)(?P<after>(?:#[^)\s]*)?\))")
EQUATION = re.compile(r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', re.S)
CODE = re.compile(r"^```.*?^```$|`[^`\n]+`", re.M | re.S)
LONGEST = 8_000_000  # bytes of a file that a page links

_folder = tempfile.TemporaryDirectory(prefix="eladapt-site-")
_outcomes: dict[str, list[tuple[Block, Outcome]]] = {}  # by page
_pages: dict[str, str] = {}  # path in the repository -> page of the site


def on_files(files: Any, config: Any) -> Any:
    """Adds the pages from elsewhere, and what the code of the others writes."""
    _pages.update({f"docs/{file.src_uri}": file.src_uri for file in files})
    for source, uri, text in _elsewhere():
        _pages[source] = uri
        files.append(File.generated(config, uri, content=text))
    own = [file for file in files.documentation_pages() if file.generated_by is None]
    own.sort(key=_in_real_time, reverse=True)
    alone = sum(map(_in_real_time, own))  # a loop in real time wants the computer for itself
    try:
        done = [_outcome(file) for file in own[:alone]]
        with ThreadPoolExecutor(os.cpu_count()) as pool:
            done += pool.map(_outcome, own[alone:])
    except BlockError as reason:
        raise PluginError(str(reason)) from None
    for file, pairs in zip(own, done, strict=True):
        _outcomes[file.src_uri] = pairs
        for name in (name for _, outcome in pairs for name in outcome.files):
            written, uri = _room(file) / name, f"{file.src_uri[:-3]}/{name}"
            if _shown(written) and files.get_file_from_path(uri) is None:
                files.append(File.generated(config, uri, abs_src_path=str(written)))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Puts outcomes below their blocks, and leads links to pages."""
    for block, outcome in reversed(_outcomes.get(page.file.src_uri, [])):
        markdown = _below(markdown, block, outcome, page.file)
    return _led(markdown, page.file.src_uri)


def on_page_content(html: str, **_: Any) -> str:
    """Equations as MathML."""
    return EQUATION.sub(_mathml, html)


def on_post_build(config: Any, **_: Any) -> None:
    """Every link leads somewhere, and nothing is left beside the site."""
    _folder.cleanup()
    if found := list(faults(Path(config.site_dir))):
        raise PluginError("\n".join(found))


def _elsewhere() -> list[tuple[str, str, str]]:
    """Path in the repository, page of the site, and text, of what stands outside of docs/."""
    found = [(f"{name.upper()}.md", f"{name}.md") for name in ("changelog", "contributing")]
    found += [("examples/README.md", "gallery.md")]
    results = sorted((ROOT / "benchmarks" / "results").glob("*.md"))
    found += [(f"benchmarks/results/{path.name}", f"benchmarks/{path.name}") for path in results]
    pages = [(source, uri, (ROOT / source).read_text("utf-8")) for source, uri in found]
    for path in sorted((ROOT / "examples").glob("*.py")):
        text = f"# {path.stem}.py\n\n````` python\n{path.read_text('utf-8')}`````\n"
        pages.append((f"examples/{path.name}", f"examples/{path.stem}.md", text))
    return pages


def _in_real_time(file: Any) -> bool:
    return "ea.run_loop(" in Path(file.abs_src_path).read_text("utf-8")


def _room(file: Any) -> Path:
    return Path(_folder.name) / file.src_uri[:-3]


def _outcome(file: Any) -> list[tuple[Block, Outcome]]:
    page = Path(file.abs_src_path)
    if "SITE_WITHOUT_CODE" in os.environ or all(block.why for block in blocks(page)):
        return []
    _room(file).mkdir(parents=True)
    return list(zip(blocks(page), run(page, _room(file)), strict=True))


def _shown(written: Path) -> bool:
    return written.suffix in (".png", ".html") and written.stat().st_size < LONGEST


def _below(markdown: str, block: Block, outcome: Outcome, file: Any) -> str:
    below = f'\n\n```text title="prints"\n{outcome.printed.rstrip()}\n```' if outcome.printed.strip() else ""
    for name in outcome.files:
        where = f"{Path(file.src_uri).stem}/{name}"
        if _shown(_room(file) / name):
            below += (
                f"\n\n![{name}]({where})"
                if name.endswith(".png")
                else f"\n\n[{name}]({where}) opens in a browser."
            )
    return markdown[: block.end] + below + markdown[block.end :]


def _led(markdown: str, uri: str) -> str:
    """The same with links to files of the repository led to their pages, outside of code."""
    source = next(path for path, page in _pages.items() if page == uri)

    def lead(found: re.Match[str]) -> str:
        target = os.path.normpath(os.path.join(os.path.dirname(source), found["target"]))
        if target not in _pages:
            return found[0]
        return (
            f"{found['before']}{os.path.relpath(_pages[target], os.path.dirname(uri) or '.')}{found['after']}"
        )

    parts, last = [], 0
    for code in CODE.finditer(markdown):
        parts += [LINK.sub(lead, markdown[last : code.start()]), code[0]]
        last = code.end()
    return "".join([*parts, LINK.sub(lead, markdown[last:])])


def _mathml(found: re.Match[str]) -> str:
    tag, opening, tex = found.groups()
    text = tex.replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&")
    equation = convert(text, display="block" if opening == "[" else "inline")
    return f'<{tag} class="equation">{equation}</{tag}>'
