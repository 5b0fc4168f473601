"""The built site is read from a folder, without a server: its search answers, and asks nobody else."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from browsing import Tab, browser

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The site without what its code prints, which the search does not need."""
    pytest.importorskip("mkdocs", reason='no mkdocs: pip install -e ".[docs]"')
    folder = tmp_path_factory.mktemp("site")
    environment = {**os.environ, "SITE_WITHOUT_CODE": "1", "NO_MKDOCS_2_WARNING": "1"}
    command = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--site-dir", str(folder)]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.mark.slow
def test_the_search_works_from_a_folder(site):
    """On a page below the first one, two words one after the other: each finds the pages that have it, and
    nothing but files is asked for."""
    with browser() as context:
        tab = Tab(context, (site / "how-to" / "faults.html").as_uri())

        def shows(typed: str, expected: str) -> None:
            query = tab.page.locator("[data-md-component=search-query]")
            query.fill("")
            query.press_sequentially(typed)
            tab.page.wait_for_selector(f".md-search-result {expected}", state="attached", timeout=30_000)

        shows("jitter", '.md-search-result__link[href*="how-to/noise-and-delay.html"]')
        shows("gripper", '.md-search-result__link[href*="how-to/locked-joints.html"]')
        shows("xylophone", ":text('No matching documents')")
        assert tab.errors == []
        assert all(url.startswith("file:") for url in tab.requests)
