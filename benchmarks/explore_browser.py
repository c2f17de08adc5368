"""Time slider changes of `explore` in JupyterLab, in a headless browser.

    python benchmarks/explore_browser.py --changes 30

A notebook shows the widget of each problem. A change sets one slider to a random value of its
range, and ends with the frame that shows the result. It needs JupyterLab, Selenium, Chromium and
chromedriver. Without them the script prints the missing part.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import random
import secrets
import shutil
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.error import URLError
from urllib.request import urlopen

BOUND = 0.1
"""Longest median time of a change [s]."""

PROBLEMS = {
    "motor_pendulum": "",
    "forced_oscillator": ", vary={'A': (0.9, 1.4), 'restitution': (0.1, 0.5)}",
    "two_motors": "",
}
"""Problem to the further arguments of its widget."""

READY = "window.jupyterapp.shell.currentWidget.sessionContext.session?.kernel?.status == 'idle'"
"""Whether the notebook's kernel waits for cells."""

CHANGE = """
const [index, slider, share, done] = arguments;
const root = document.querySelectorAll(".zeno-explore")[index];
const input = root.querySelectorAll("input")[slider];
const [low, high] = [Number(input.min), Number(input.max)];
const begun = performance.now();
new MutationObserver((_, observer) => {
  observer.disconnect();
  requestAnimationFrame(() => done({
    seconds: (performance.now() - begun) / 1000,
    python: Number(root.dataset.seconds),
    name: root.querySelector(".name").textContent,
  }));
}).observe(root.querySelector(".name"), { childList: true });
input.value = low + share * (high - low);
input.dispatchEvent(new Event("input"));
"""


def missing() -> str:
    """Return the first part that is not installed, or nothing."""
    modules = [name for name in ("jupyterlab", "selenium") if not importlib.util.find_spec(name)]
    programs = [name for name in ("chromium", "chromedriver") if not shutil.which(name)]
    return next(iter([*modules, *programs]), "")


def notebook(problems: list[str]) -> dict[str, Any]:
    """Return a notebook with the widget of each problem."""
    sources = [
        "import zeno_orbits as zo",
        *(f"zo.explore('{name}'{PROBLEMS[name]})" for name in problems),
    ]
    cells: list[dict[str, Any]] = [
        {"cell_type": "code", "id": f"cell-{k}", "metadata": {}, "outputs": [], "source": source}
        | {"execution_count": None}
        for k, source in enumerate(sources)
    ]
    kernel = {"kernelspec": {"name": "python3", "display_name": "Python 3", "language": "python"}}
    return {"cells": cells, "metadata": kernel, "nbformat": 4, "nbformat_minor": 5}


@contextmanager
def laboratory(folder: Path) -> Generator[str]:
    """Run JupyterLab in a folder, and yield its address with the token."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    token = secrets.token_hex(16)
    words = [
        *(sys.executable, "-m", "jupyterlab", "--no-browser", "--allow-root"),
        *(f"--ServerApp.port={port}", f"--IdentityProvider.token={token}"),
        *("--LabApp.expose_app_in_browser=True", "--ServerApp.log_level=ERROR"),
    ]
    with (folder / "log").open("w") as log:
        server = subprocess.Popen(words, cwd=folder, stdout=log, stderr=log, env={**os.environ})
    try:
        for _ in range(300):
            try:
                urlopen(f"http://127.0.0.1:{port}/api?token={token}").close()
                break
            except URLError:
                time.sleep(0.2)
        yield f"http://127.0.0.1:{port}/lab/tree/explore.ipynb?token={token}"
    finally:
        server.terminate()
        server.wait(30)


@contextmanager
def browser() -> Generator[Any]:
    """Yield a headless Chromium."""
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    for word in ("--headless=new", "--no-sandbox", "--disable-gpu", "--window-size=1200,4000"):
        options.add_argument(word)
    driver = webdriver.Chrome(options=options, service=Service(shutil.which("chromedriver")))
    try:
        yield driver
    finally:
        driver.quit()


def until(driver: Any, condition: str, seconds: float) -> None:
    """Wait until an expression in JavaScript is true."""
    for _ in range(int(10 * seconds)):
        if driver.execute_script(f"return Boolean({condition})"):
            return
        time.sleep(0.1)
    raise TimeoutError(condition)


def measured(driver: Any, index: int, changes: int, seed: int) -> list[dict[str, Any]]:
    """Return time, time in Python and attractor of each change of one widget."""
    chance = random.Random(seed)
    sliders = driver.execute_script(
        "return document.querySelectorAll('.zeno-explore')[arguments[0]]"
        ".querySelectorAll('input').length",
        index,
    )
    return [
        driver.execute_async_script(CHANGE, index, chance.randrange(sliders), chance.random())
        for _ in range(changes)
    ]


def main() -> int:
    """Print the times of every problem. Returns 1 if a median is above the bound."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--problems", nargs="+", default=[*PROBLEMS], choices=[*PROBLEMS])
    parser.add_argument("--changes", type=int, default=30, help="changes per problem")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--picture", type=Path, help="PNG file of the browser's window")
    options = parser.parse_args()
    if lacking := missing():
        print(f"Left out: {lacking} is not installed.")
        return 0
    good = True
    with tempfile.TemporaryDirectory() as place:
        file = Path(place) / "explore.ipynb"
        file.write_text(json.dumps(notebook(options.problems)))
        with laboratory(Path(place)) as address, browser() as driver:
            driver.set_script_timeout(60)
            driver.get(address)
            until(driver, "window.jupyterapp && document.querySelector('.jp-Notebook')", 60)
            until(driver, READY, 60)
            driver.execute_script("window.jupyterapp.commands.execute('notebook:run-all-cells')")
            count = len(options.problems)
            until(driver, f"document.querySelectorAll('.zeno-explore').length == {count}", 60)
            print(
                "problem            median [ms]  90 % [ms]  largest [ms]  Python [ms]  attractors"
            )
            for index, name in enumerate(options.problems):
                found = measured(driver, index, options.changes, options.seed)
                times = sorted(1e3 * one["seconds"] for one in found)
                python = statistics.median(1e3 * one["python"] for one in found)
                median = statistics.median(times)
                kinds = len({one["name"] for one in found})
                print(
                    f"{name:18} {median:11.0f} {times[int(0.9 * (len(times) - 1))]:10.0f} "
                    f"{times[-1]:13.0f} {python:12.0f} {kinds:11}"
                )
                good = good and median < 1e3 * BOUND
            if options.picture:
                driver.save_screenshot(str(options.picture))
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
