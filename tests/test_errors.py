"""An error says what may be meant, and what to install."""

import importlib.metadata
import pickle

import pytest

from eladapt.errors import EladaptError, RunInterrupted, UnknownNameError, installing, needing


def test_what_is_missing_is_named_as_it_can_be_installed(monkeypatch):
    """The packages themselves, with their bounds, since eladapt may be in no index."""
    listed = ["numpy>=2.0", 'bokeh>=3.6; extra == "report"', "pin-pink>=4.4 ; extra == 'motion'",
              "daqp>=0.7; extra == 'motion'"]  # fmt: skip
    monkeypatch.setattr(importlib.metadata, "requires", lambda _: listed)
    assert installing("report") == 'pip install "bokeh>=3.6"'
    assert installing("motion") == 'pip install "pin-pink>=4.4" "daqp>=0.7"'
    said = r'needs Bokeh, which is not installed \(.*\): pip install "bokeh'
    with pytest.raises(EladaptError, match=said), needing("a report needs Bokeh", "report"):
        import no_such_package  # noqa: F401
    monkeypatch.setattr(importlib.metadata, "requires", lambda _: None)
    assert installing("report") == "it comes with the extra report of eladapt"


def test_an_unknown_name_says_which_is_near_and_what_to_do():
    error = UnknownNameError("robot", ["pandaa", "xyz"], ["ur5", "panda"], "Look again")
    said = "unknown robot 'pandaa', 'xyz' (did you mean 'panda'?); legal names: ur5, panda. Look again"
    assert str(error) == said
    assert str(pickle.loads(pickle.dumps(error))) == said
    assert str(UnknownNameError("robot", ["xyz"], [])) == "unknown robot 'xyz'; legal names: (none)"


def test_an_interrupted_run_is_a_keyboard_interrupt_with_its_record():
    """Also from another process."""
    stopped = pickle.loads(pickle.dumps(RunInterrupted([1, 2, 3])))
    assert isinstance(stopped, KeyboardInterrupt)
    assert not isinstance(stopped, EladaptError)
    assert stopped.record == [1, 2, 3]
    assert "3 samples" in str(stopped)
