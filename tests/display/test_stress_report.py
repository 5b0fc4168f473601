"""The page of a stress test says how many failed, of what, and what explains it."""

import itertools

import numpy as np
import pytest
from browsing import Tab, browser
from shared import load

import eladapt as ea
from eladapt.errors import ArgumentError
from eladapt.worlds.rows import FACTORS, MEASURES, row_of
from eladapt.worlds.trials import Trials

TABS = ("Overview", "Where it fails", "Distributions", "Worst worlds", "Set-up")
FAILED = 3.0  # [kg] from which on the made worlds fail


def made(path, worlds: int = 300, heaviest: float = 4.0) -> ea.Stress:
    """Rows without a simulation: worlds fail where the load is heavy, some of them by a fault."""
    rng, rows = np.random.default_rng(0), []
    for seed in range(worlds):
        row = {name: rng.uniform(1e-3, 1) for name in (*FACTORS, *MEASURES)} | {"seed": seed, "good": True}
        row["load"] = rng.uniform(0, heaviest)
        if row["load"] > FAILED:
            cause = "fault: unresponsive" if seed % 3 == 0 else "not settled"
            row |= {"good": False, "cause": cause, "said": "<b>0.1 rad</b>", "settling": np.inf}
        rows.append(row_of(row))
    result = ea.Stress(Trials(load("two_link")), path, 0, worlds)
    result.__dict__["rows"] = np.array(rows)
    return result


def test_the_page_names_counts_causes_and_the_factor(tmp_path):
    result = made(tmp_path)
    page = result.report(tmp_path / "stress.html").read_text("utf-8")
    good = int(result.good.sum())
    assert f"{good} of 300 good" in page
    assert "fault: unresponsive" in page
    assert "more load [kg]" in page
    assert "<b>0.1 rad" not in page  # what a run said cannot become markup


@pytest.mark.parametrize(("worlds", "heaviest"), [(1, 4.0), (40, 1.0)])
def test_few_worlds_and_none_that_failed_make_a_page(tmp_path, worlds, heaviest):
    result = made(tmp_path, worlds, heaviest)
    page = result.report(tmp_path / "stress.html").read_text("utf-8")
    assert f"{int(result.good.sum())} of {worlds} good" in page


def test_a_page_is_html(tmp_path):
    with pytest.raises(ArgumentError, match=r"ends in \.html"):
        made(tmp_path, 3).report(tmp_path / "stress.txt")


@pytest.mark.slow
def test_every_tab_opens_in_a_browser_and_asks_nobody(tmp_path):
    with browser() as chrome:
        tab = Tab(chrome, made(tmp_path).report(tmp_path / "stress.html").resolve().as_uri())
        pictures = []
        for title in TABS:
            tab.page.get_by_text(title, exact=True).locator("visible=true").first.click()
            pictures.append(tab.settled())
        for one, other in itertools.pairwise(pictures):
            assert not np.array_equal(one, other)
        assert tab.foreign() == []
        assert tab.errors == []
