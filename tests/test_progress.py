"""Progress bars appear where a person watches, vanish at the end, and leave pipes and saved notebooks as they are."""

import io
import sys
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import nbformat
import pytest
import tqdm
from nbclient import NotebookClient

from plr_jax import _progress
from plr_jax._progress import Progress

CELL = """from plr_jax import _progress, scenes
import plr_jax
_progress._DELAY = 0.0
print("before")
workspace, goal = scenes.maze().workspace, scenes.maze().goals[0]
plr_jax.construct(plr_jax.VisibilityGraph(workspace, goal), workspace.bounds, leaf="plane", max_leaves=64)
print("after")"""


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.fixture(autouse=True)
def at_once(monkeypatch):
    """Show bars without a delay."""
    monkeypatch.setattr(_progress, "_DELAY", 0.0)


def shown_by(file, monkeypatch, call):
    monkeypatch.setattr(sys, "stderr", file)
    call()
    return file.getvalue()


def count_to_ten():
    with Progress("count", "numbers", 10) as progress:
        for number in range(10):
            progress.update(1, f"at {number}")


def test_bar_on_a_terminal_vanishes(monkeypatch):
    lines = shown_by(Terminal(), monkeypatch, count_to_ten).split("\r")
    assert any("count:" in line and "/10" in line for line in lines)
    assert lines[-1].strip() == lines[-2].strip() == ""


def test_calls_end_where_no_bar_can_be_drawn(monkeypatch):
    monkeypatch.setattr(tqdm, "tqdm", partial(tqdm.tqdm, disable=True))  # as by the environment variable TQDM_DISABLE
    assert shown_by(Terminal(), monkeypatch, count_to_ten) == ""
    monkeypatch.setattr(sys, "stderr", object())  # a writer of logs without `isatty`
    monkeypatch.setitem(sys.modules, "IPython", None)  # an import that is refused
    count_to_ten()


def test_processes_that_fork_show_no_bars(monkeypatch):
    monkeypatch.setattr(_progress, "_PROCESS", -1)
    assert shown_by(Terminal(), monkeypatch, count_to_ten) == ""


def test_bar_vanishes_after_an_error(monkeypatch):
    def fail():
        with pytest.raises(KeyboardInterrupt), Progress("count", "numbers"):
            raise KeyboardInterrupt

    lines = shown_by(Terminal(), monkeypatch, fail).split("\r")
    assert "count:" in lines[1] and lines[-1].strip() == lines[-2].strip() == ""


def test_short_calls_show_nothing(monkeypatch):
    monkeypatch.setattr(_progress, "_DELAY", 1e9)
    assert shown_by(Terminal(), monkeypatch, count_to_ten) == ""


def test_pipes_get_no_bar(monkeypatch):
    assert shown_by(io.StringIO(), monkeypatch, count_to_ten) == ""
    monkeypatch.setattr(sys, "stderr", None)  # as in windowed programs
    count_to_ten()


def test_threads_show_no_bar(monkeypatch):
    with ThreadPoolExecutor(1) as pool:
        assert shown_by(Terminal(), monkeypatch, lambda: pool.submit(count_to_ten).result()) == ""


@pytest.mark.full
@pytest.mark.parametrize("is_watched", [True, False])
@pytest.mark.filterwarnings("ignore")  # of ZeroMQ and asyncio
def test_bar_in_a_notebook_leaves_nothing(is_watched):
    """A front end that answers questions has a person before it; a batch run does not, and gets no message."""
    lines = []

    class Client(NotebookClient):
        def process_message(self, msg, cell, cell_index):
            if "display" in msg["msg_type"]:
                lines.append(msg["content"]["data"].get("text/plain", ""))
            return super().process_message(msg, cell, cell_index)

    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(CELL)])
    client = Client(notebook, kernel_name="python3", timeout=300)
    with client.setup_kernel():
        assert client.kc is not None
        client.kc.allow_stdin = is_watched
        client.execute_cell(notebook.cells[0], 0)
    outputs = notebook.cells[0].outputs
    assert "".join(output.get("text", "") for output in outputs) == "before\nafter\n"
    assert {output.get("name", "stdout") for output in outputs} == {"stdout"}  # no stderr
    assert not any(output.get("data") for output in outputs)
    nbformat.validate(notebook)
    if is_watched:
        assert any(line.startswith("construct:") for line in lines) and lines[-1] == ""
    else:
        assert lines == [] and all(output.output_type == "stream" for output in outputs)
