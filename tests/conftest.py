"""Settings of the whole suite: one BLAS thread a worker; hypothesis without a clock, as a first call may compile.

And a browser without a screen, where one is installed.
"""

import html
import json
import os
import re
import shutil
import subprocess
from contextlib import chdir
from dataclasses import dataclass
from importlib import resources

import jaxtyping
import pytest
from hypothesis import settings

import tests.type_checking

jaxtyping.install_import_hook(["rig", "identify"], f"{tests.type_checking.checked.__module__}.checked")

for library in ("OPENBLAS", "OMP", "MKL"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")

os.environ.setdefault("LOKY_MAX_CPU_COUNT", "1")  # as a worker of the suite has one core

LONG_FOLDERS = {"commands", "contacts", "history", "laws", "planning", "robustness", "scenarios", "test_campaigns"}
"""Folders of tests that run whole commands and identifications."""

settings.register_profile("physics", deadline=None, max_examples=60)
settings.load_profile("physics")

_MEASURE = """
this.contentDocument.querySelectorAll("details").forEach(one => one.open = true);
setTimeout(() => {
const page = this.contentDocument;
const pictures = [...page.images].map(image => image.naturalWidth);
const plots = [...page.querySelectorAll(".plot")].map(plot => plot.scrollHeight);
this.title = JSON.stringify([page.scrollingElement.scrollWidth, pictures, plots]);
}, 3000);
"""
_CHECK = """
this.contentDocument.querySelectorAll("details").forEach(one => one.open = true);
setTimeout(() => this.contentWindow.axe.run().then(({violations}) => {
this.title = JSON.stringify(violations.map(({id, nodes}) => `${id}: ${nodes[0].html}`));
}), 2000);
"""


def pytest_collection_modifyitems(items):
    """Long modules first: the workers then end together, and each such module makes its null reference once."""
    items.sort(key=lambda item: item.get_closest_marker("long") is None)
    for item in items:
        if not LONG_FOLDERS.isdisjoint(item.path.parts):
            item.add_marker("long")


@pytest.fixture(autouse=True)
def no_progress_lines(monkeypatch):
    """A busy machine takes longer than what a line of progress is printed after."""
    monkeypatch.setattr("rig.commands.command_line.PROGRESS_LINE_PERIOD_S", 1e6)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item):
    """Types and shapes of the first calls of every function are checked in every test, but where fakes stand in."""
    jaxtyping.config.update("jaxtyping_disable", item.get_closest_marker("fakes") is not None)
    tests.type_checking.begin_test()
    return (yield)


@pytest.fixture
def in_folder(tmp_path):
    """An empty folder, which is the current one during the test."""
    with chdir(tmp_path):
        yield tmp_path


@dataclass(frozen=True)
class Opened:
    """A page as a browser has it: how wide it scrolls, each picture's width and each plot's height (0: not shown), and
    what the console said."""

    scroll_px: int
    pictures_px: tuple[int, ...]
    plots_px: tuple[int, ...]
    console: tuple[str, ...]


@pytest.fixture(scope="session")
def framed_in(tmp_path_factory):
    """Function that opens HTML in a frame of so many pixels for each colour scheme, runs a script when it has loaded,
    and returns what this wrote as each frame's title, and the messages of the browser; skips the test where there is no
    Chromium.

    The variable CHROMIUM says where it is; what is not there then fails the test.
    """
    browser = os.environ.get("CHROMIUM") or shutil.which("chromium")
    if browser is None:
        pytest.skip("no Chromium")

    def open_frames(content, width_px, script, colour_schemes):
        folder = tmp_path_factory.mktemp("browser")
        frames = ""
        for scheme in colour_schemes:
            style = f"border:0;width:{width_px}px;height:800px;color-scheme:{scheme}"
            frames += (
                f'<iframe style="{style}" onload="{html.escape(script)}" srcdoc="{html.escape(content)}"></iframe>'
            )
        outer = folder / "outer.html"
        outer.write_text(frames, encoding="utf-8")
        words = (
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--hide-scrollbars",
            "--virtual-time-budget=6000",
            f"--user-data-dir={folder}",
        )
        told = ("--enable-logging=stderr", "--dump-dom", outer.as_uri())
        done = subprocess.run([browser, *words, *told], capture_output=True, text=True, check=True, timeout=180)
        titles = re.findall(r'title="(\[.*?\])"', done.stdout)
        assert len(titles) == len(colour_schemes)
        return [json.loads(html.unescape(title)) for title in titles], done.stderr.splitlines()

    return open_frames


@pytest.fixture(scope="session")
def framed(framed_in):
    """Function as `framed_in` of a single frame in light colours."""

    def open_frame(content, width_px, script):
        (title,), lines = framed_in(content, width_px, script, ["light"])
        return title, lines

    return open_frame


@pytest.fixture(scope="session")
def opened(framed):
    """Function that opens an HTML file in a window of so many pixels."""

    def open_page(path, width_px):
        (width, pictures, plots), lines = framed(path.read_text(encoding="utf-8"), width_px, _MEASURE)
        said = [line for line in lines if "CONSOLE" in line]
        spoken = tuple(line for line in said if not ("[bokeh" in line and "document idle" in line))
        return Opened(width, tuple(pictures), tuple(plots), spoken)

    return open_page


@pytest.fixture(scope="session")
def inaccessible(framed_in):
    """Function that returns what axe-core finds wrong with an HTML file, in light and dark colours; skips the test
    without axe-core."""
    axe_core = pytest.importorskip("axe_core_python", reason="no axe-core")
    axe = (resources.files(axe_core) / "axe.min.js").read_text(encoding="utf-8")

    def check_page(path, width_px):
        content = f"{path.read_text(encoding='utf-8')}<script>{axe}</script>"
        light_and_dark, _ = framed_in(content, width_px, _CHECK, ["light", "dark"])
        return [finding for findings in light_and_dark for finding in findings]

    return check_page
