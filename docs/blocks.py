"""The code blocks of a page, run in order in one interpreter and one folder: what they print and write.

    python docs/blocks.py docs/start.md FOLDER    # as JSON, one entry a block

Blocks of python and sh are run. One that cannot be, as with a robot that is not there, says so in the line
before it: <!-- not run: why -->. The site is built from what comes of it, and the tests run the README so.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import subprocess
import sys
import traceback
from pathlib import Path
from typing import Any, NamedTuple

FENCE = re.compile(
    r"^(?:<!-- not run: (?P<why>[^\n]+?) -->\n)?```(?P<language>python|sh)[^\n]*\n(?P<code>.*?)^```$",
    re.M | re.S,
)
HIDDEN = re.compile(r"^[ \t]+```(python|sh)", re.M)
SECONDS = 240  # for one page


class Block(NamedTuple):
    """A block of code, where it stands, and why it is not run ("" where it is)."""

    language: str
    code: str
    line: int  # of its first line of code, from 1
    end: int  # offset of what follows it in the page
    why: str


class Outcome(NamedTuple):
    """What a block printed, and the files that it wrote, by name."""

    printed: str
    files: list[str]


class BlockError(Exception):
    """A block failed; the message names page, line and reason."""


def blocks(page: Path) -> list[Block]:
    """The blocks of a page in their order. Raises BlockError for one that is indented, and so not found."""
    text = page.read_text("utf-8")
    if hidden := HIDDEN.search(text):
        line = text.count("\n", 0, hidden.start()) + 1
        raise BlockError(f"{page}:{line}: a code block that is indented is not run; begin it in column 1")
    return [
        Block(
            found["language"],
            found["code"],
            text.count("\n", 0, found.start("code")) + 1,
            found.end(),
            found["why"] or "",
        )
        for found in FENCE.finditer(text)
    ]


def run(page: Path, folder: Path) -> list[Outcome]:
    """The outcome of each block of a page, in a process of its own. Raises BlockError for one that fails."""
    environment = {
        **os.environ,
        "OPENBLAS_NUM_THREADS": "1",
        "OMP_NUM_THREADS": "1",
        "MPLBACKEND": "agg",
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ.get('PATH', '')}",
    }
    command = [sys.executable, str(Path(__file__).resolve()), str(page.resolve()), str(folder)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=SECONDS, env=environment)
    except subprocess.TimeoutExpired:
        raise BlockError(f"{page}: its blocks take longer than {SECONDS} s") from None
    if done.returncode:
        raise BlockError(done.stderr.strip() or f"{page}: its blocks ended with {done.returncode}")
    return [Outcome(*entry) for entry in json.loads(done.stdout)]


def main() -> None:
    page, folder = Path(sys.argv[1]), Path(sys.argv[2])
    os.chdir(folder)
    namespace: dict[str, Any] = {"__name__": "__main__"}
    outcomes = []
    for block in blocks(page):
        before, printed = _written(folder), ""
        if not block.why:
            printed = (_python if block.language == "python" else _shell)(block, page, namespace)
        after = _written(folder)
        files = sorted(name for name in after if after[name] != before.get(name))
        outcomes.append((printed.replace(f"{folder}/", "").replace(sys.prefix, ".venv"), files))
    json.dump(outcomes, sys.stdout)


def _written(folder: Path) -> dict[str, int]:
    """The files of a folder by name, and when they were written."""
    return {str(p.relative_to(folder)): p.stat().st_mtime_ns for p in folder.rglob("*") if p.is_file()}


def _python(block: Block, page: Path, namespace: dict[str, Any]) -> str:
    printed = io.StringIO()
    placed = "\n" * (block.line - 1) + block.code  # so that a traceback has the page's lines
    try:
        with contextlib.redirect_stdout(printed):
            exec(compile(placed, str(page), "exec"), namespace)
    except BaseException as reason:
        trace = "".join(traceback.format_exception(reason))
        sys.exit(f"{page}:{block.line}: this block raises {type(reason).__name__}: {reason}\n{trace}")
    return printed.getvalue()


def _shell(block: Block, page: Path, _: dict[str, Any]) -> str:
    command = ["bash", "-euc", block.code]
    done = subprocess.run(command, capture_output=True, text=True, timeout=SECONDS)
    if done.returncode:
        sys.exit(f"{page}:{block.line}: this block ends with {done.returncode}\n{done.stdout}{done.stderr}")
    return done.stdout


if __name__ == "__main__":
    main()
