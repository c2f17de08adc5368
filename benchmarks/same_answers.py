"""Record the answers of the command line, and hold two recordings against each other.

    python benchmarks/same_answers.py record FOLDER [--python PYTHON]
    python benchmarks/same_answers.py compare OLD NEW [--within 1e-9]

Exit codes must be equal, and every digit of JSON, tables and CSV, or, where engines differ, every
number to the given part of itself. Words (`--words` shows where), versions and times may change. Of
pictures and pages the names count, of misuse one line of error.
"""

from __future__ import annotations

import argparse
import difflib
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

PATIENCE = 300.0
"""How long a command may take [s]; one that takes longer has the exit code -1."""
MISUSE = 2
DRAWN = (".png", ".pdf", ".svg", ".gif", ".mp4", ".html")
PASSING = {"versions", "seconds", "on_front", "bytes"}
"""Entries that are no answers: times of a trade, who is best by them, the size of a page."""
ESTIMATES = re.compile(r"error|residual|energy_gain|delta_|closure|agreement|iterations|unknowns")
"""Entries that say how far from the truth others may be; they pass where digits may differ."""
LEAST = 1e-3
"""What is smaller differs from zero by errors."""
TIMES = re.compile(r"(Search:|iterations,)\s+[\d.]+\s+s\b")
NUMBER = re.compile(r"(?<![\w.])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?!\w)")
NOISE = re.compile(r" *\d+\.\d s  |.*resource_tracker|  warnings\.warn")

PROBLEMS = """bouncing_ball curved_surface falling_pendulum forced_oscillator impact_oscillator
motor_cart motor_pendulum motor_pendulum@corrected motor_pendulum@quasi_static motor_valve
torque_pendulum two_motors two_tone_table vibrating_table"""
COMMANDS = """
PROBLEM = search PROBLEM --n-starts 3 -o orbit.json --json
data = simulate motor_pendulum --until 28 --rate 100 --output data.csv --noise 1e-3
costs = work-precision motor_pendulum --quick --json -o trade.json --plot trade.png
orbit = search motor_pendulum --set Kp=2.5 --set Kd=-1 -o orbit.json
struck = search impact_oscillator --set omega=0.5 --set stop=0.5 -o orbit.json
curves = continue forced_oscillator --parameter A=0.78:0.9 --parameter2 stop=-0.82:-0.78
    -o family.json
forced = new forced
flap = new flap --with-motor --json
found = search @forced/forced.py -o orbit.json
zeno-condition PROBLEM --json
simulate PROBLEM --until 5 --json
problems :: ; --json ; --loud
zeno-condition :: motor_pendulum --plot region.png ; bouncing_ball --set g=-9.81 ; fly
simulate motor_pendulum --until 6 :: ; --engine explicit --json ; --engine implicit --json ;
    --set L=1e-6 --json ; --engine explicit --accuracy 1e-10 ; --set restitution=0.97 --json ;
    --start theta1=1.2 --set Kp=3 --plot run.svg ; --set m1=-0.3 ; --set Ki=1 ; -o run.gif
simulate :: bouncing_ball --until 600 --set restitution=0.999 --json ; @made/no_scene.py ; fly
reduced-models :: motor_pendulum --measure --json ; motor_pendulum --set L=0.02 ; bouncing_ball
work-precision --quick :: bouncing_ball --until 5 --json ; vibrating_table ; bouncing_ball --until 0
search motor_pendulum --set Kp=2.5 --set Kd=-1 :: --accuracy 1e-8 ; --engine explicit --json ;
    --set L=1e-5 --json ; --set restitution=0 --json ; --objective energy ; --vary L1=0.198:0.202
    --objective peak=current --near @orbit ; --vary R=2:4 --objective period=1.8 --json
search motor_pendulum --n-starts 2 --set Kp=2.5 :: --objective contraction ; --objective margin
    --json ; --checkpoint kept --json ; --objective amplitude=0.6 ; --bounds current=-2.2:2.2
    --bounds period=:1.9 ; --objective energy --bounds theta2=:1.9 --json ; --set Kd=1
search motor_pendulum --n-starts 2 --json :: --objective nearest:Kp=3,Kd=-0.9 ;
    --objective period=5 ;
    --objective energy --candidates 2 ; --vary Kp=1:5 --set Kd=-1 --objective period=1.83 ;
    --set Kp=4.3 --set Kd=-1.53 --shape zeno*2 ; --near @orbit --set restitution=0.3 ;
    --near none.json ; --near @struck ; --set Ki=1 ; --objective speed ; --shape bounce
search --n-starts 2 --json :: two_motors --set Kp2=0 --objective energy ; @flap/flap.py ; motor_cart
    --objective energy ; motor_valve --objective period=0.3
search impact_oscillator --json :: --near @struck --set omega=0.51 ; --near @struck --shape zeno ;
    --set omega=0.5 --set stop=0.5 --shape impact ; --vary A=0.5:2 --objective energy
verify :: ; none.json ; @orbit ; @orbit --json ; @orbit --model reference --json ; @orbit
    --engine explicit ; @orbit --accuracy 1e-8 ; @orbit --tolerance 1e-13 ; @orbit --tolerance 0 ;
    @struck --json ; @motor_cart --json ; @two_motors --json ; @two_tone_table ;
    @motor_pendulum@corrected --model reference --json ; @found --problem @forced/forced.py
verify :: @made/longer_period.json --json ; @made/wrong_sign.json --json ; @made/later_zeno.json ;
    @made/moved_release.json --json ; @made/newer.json ; @made/cut_short.json
map motor_pendulum :: --x Kp=1:5 --y Kd=-2:0 --grid 5x5 --json -o map.json ; --x Kp=1:5
map --grid 3x3 :: motor_pendulum@corrected --x restitution=0:0.5 --y Kd=-1.6:-0.4 ; bouncing_ball
    --x g=5:10 --y restitution=0.1:0.6 ; torque_pendulum --x A=0.2:0.6 --y omega=2:4
map --grid 3x3 --json :: vibrating_table --x A=0.01:0.06 --y restitution=0.1:0.7 ;
    impact_oscillator --x omega=0.4:1.2 --y stop=0.2:1 ; two_motors --x Kp=1:4 --y Kd=-1.5:-0.5 ;
    motor_valve --x Kp=6:20 --y restitution=0.1:0.6 --checkpoint kept ; forced_oscillator
    --x A=0.7:1.2 --y stop=-0.9:-0.7 --plot map.png --boundaries @curves/family.json
continue motor_pendulum --json :: --parameter Kd=-2.5:0 ; --parameter Kp=2.4:2.6 --near @orbit ;
    --parameter restitution=0:0.5 -o family.json --plot family.png ; --set Kp=4.3 --set Kd=-1.55
    --parameter Kd=-1.6:-1.53 ; --parameter Kd=-1.7:-1.5 --parameter2 Kp=2.45:2.55 --kind fold
continue impact_oscillator --section impact --start speed=1 --start cosine=1 ::
    --parameter A=0.05:1.5
    --json ; --parameter omega=2.4:2.8 --set stop=0 --set omega=2.5
continue :: vibrating_table --parameter A=0.011:0.02 ; forced_oscillator --parameter A=1:2
    --section impact ;
    motor_valve --parameter Kp=8:12 --max-points 5 --json ; two_motors --parameter Kp2=0.9:1.1
    --json ; motor_cart
    --parameter restitution=0.2:0.4 ; bouncing_ball --parameter g=9:10
plot :: @orbit ; @vibrating_table --kind outputs --format pdf ; @struck --json ; @struck --kind zeno
figures :: @orbit -o . --json ; @orbit ; @two_tone_table -o . ;
    @orbit -o . --recording @data/data.csv
report :: @orbit -o page.html --trade @costs/trade.json --json ; @struck -o page.html ; @orbit
    -o page.txt ; @orbit -o page.html --trade @orbit ; @made/moved_release.json -o page.html
rig :: @orbit --only friction --part contact.stiffness=1e5 --cycles 2 -o run.csv ; @orbit
    --set Kp=2 ; @orbit --cycles 3 --seed 3 --without gears --json ; @orbit --only controller
    --part controller.delay=100 --cycles 8 --json ; @motor_valve --cycles 3 --json ; @orbit
    --only friction --part friction.theta1.coulomb=0.5 --cycles 1 ; motor_pendulum --until 0.5
    --only bridge ; bouncing_ball --part contact.stiffness=1e6 --until 1.5 -o run.csv
compare @orbit :: @data/data.csv --t-start 12 --json ; none.csv ; @made/degrees.csv --t-start 12 ;
    @data/data.csv --t-start 20 --t-end 26 --plot compared.png ; @data/data.csv --t-start 99
identify motor_pendulum --t-start 12 :: @data/data.csv --fit K_torque+K_emf=0.02:0.05 --json ;
    @made/degrees.csv --fit R ; @data/data.csv --fit R,restitution -o fit.json
new :: no-name ; bouncing_ball
"""
"""A command a line; between `;` are endings of what is before `::`; an indented line goes on. Later
ones read the files of what has a name, `NAME = `, as `@NAME/FILE`, or its orbit as `@NAME`."""
SPOILED: dict[str, dict[str, Any]] = {
    "longer_period": {"period": 1.8137147},
    "moved_release": {"start_state": {"current": -1.858}},
    "wrong_sign": {"start_state": {"dtheta1": 5.236537552}},
    "newer": {"format": 99},
}
"""Name in `@made/` to what is false in it; the rest is `@orbit`."""


def commands(only: str) -> dict[str, tuple[str, ...]]:
    """Return label to words of the commands that a pattern fits, and of those that they need."""
    lines: dict[str, None] = {}
    for line in COMMANDS.replace("\n    ", " ").strip().split("\n"):
        start, _, endings = line.partition(" ::")
        for full in (f"{start} {ending}" for ending in endings.split(" ;")):
            lines |= dict.fromkeys(full.replace("PROBLEM", name) for name in PROBLEMS.split())
    found: dict[str, tuple[str, ...]] = {}
    needed: set[str] = set()
    for number, line in reversed([*enumerate(lines)]):
        name, sign, rest = line.partition(" = ")
        words = tuple(shlex.split(rest if sign else line))
        label = f"{number:03d}-{name if sign else words[0]}"
        if re.search(only, f"{label} {shlex.join(words)}") or (sign and name in needed):
            found[label] = words
            needed |= {word[1:].partition("/")[0] for word in words if word[0] == "@"}
            needed |= {"orbit", "data"} if "made" in needed else set()
    return dict(sorted(found.items()))


def spoil(folder: Path) -> None:
    """Write files that are false or broken, made of good ones."""
    good = ("*-orbit/orbit.json", "*-data/data.csv")
    orbit, data = (next(folder.glob(name)).read_text() for name in good)
    (made := folder / "made").mkdir(exist_ok=True)
    for name, changes in SPOILED.items():
        entries = json.loads(orbit)
        for entry, value in changes.items():
            entries[entry] = entries[entry] | value if isinstance(value, dict) else value
        (made / f"{name}.json").write_text(json.dumps(entries))
    (made / "cut_short.json").write_text(orbit[:999])
    (made / "no_scene.py").write_text("PROBLEM = 3\n")
    (made / "degrees.csv").write_text(data.replace("theta1 [rad]", "theta1 [deg]"))


def run(options: argparse.Namespace, label: str, words: Sequence[str]) -> None:
    """Run a command in a folder of its own and keep its answer beside it."""
    place: Path = options.folder / label
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir()
    argv = [options.python, "-m", "zeno_orbits", *words]
    for k, word in enumerate(argv):
        if word[0] == "@":
            name, _, file = word[1:].partition("/")
            source = next(options.folder.glob(f"???-{name}/" if name != "made" else name))
            argv[k] = os.path.relpath(source / (file or "orbit.json"), place)
    argv += ["--workers", "1"] if words[0] in ("search", "map", "continue") else []  # one core
    alone = os.environ | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
    started = time.perf_counter()
    try:
        ended = subprocess.run(argv, cwd=place, env=alone, timeout=PATIENCE, capture_output=True)
        code, out, err = ended.returncode, ended.stdout, ended.stderr
    except subprocess.TimeoutExpired as late:
        code, out, err = -1, late.stdout or b"", late.stderr or b""
    seconds = time.perf_counter() - started
    files = [one for one in sorted(place.rglob("*.*")) if one.is_file() and one.suffix != ".pyc"]
    for file in (one for one in files if one.suffix in DRAWN):
        file.write_bytes(b"")
    answer = {"words": words, "code": code, "stdout": out.decode(), "stderr": err.decode()}
    answer |= {"files": [str(one.relative_to(place)) for one in files], "seconds": seconds}
    place.with_name(f"{label}.json").write_text(json.dumps(answer, indent=1))
    print(f"{seconds:6.1f} s  exit {code}  {label}: {shlex.join(words)}", file=sys.stderr)


def record(options: argparse.Namespace) -> int:
    """Run the commands, first and one by one those whose files others read."""
    options.folder.mkdir(parents=True, exist_ok=True)
    options.python = str(Path(shutil.which(options.python) or options.python).absolute())
    whose = [options.python, "-c", "import zeno_orbits; print(zeno_orbits.__file__)"]
    subprocess.run(whose, cwd=options.folder, stdout=sys.stderr, check=True)
    wanted = commands(options.only)
    for label in [label for label, words in wanted.items() if label[4:] != words[0]]:
        run(options, label, wanted.pop(label))
    if any(word.startswith("@made") for words in wanted.values() for word in words):
        spoil(options.folder)
    with ThreadPoolExecutor(options.jobs) as pool:
        list(pool.map(lambda label: run(options, label, wanted[label]), wanted))
    return 0


def differences(old: Path, new: Path, within: float) -> Iterator[str]:
    """Yield how an answer differs from an older one, numbers by more than a part of themselves."""
    one, two = (json.loads(path.read_text()) for path in (old, new))
    before, errors = (lines_of(answer["stderr"]) for answer in (one, two))
    if one["words"] != two["words"]:
        yield "another command"
    elif one["code"] != two["code"]:
        yield f"exit code {one['code']}, now {two['code']}: {' '.join(errors)}"
    elif len(errors) != (1 if two["code"] == MISUSE else len(before)):
        yield f"{len(errors)} lines of error: {' '.join(errors)}"
    elif two["code"] != MISUSE:
        # The table of a trade marks and picks what was fastest.
        if one["words"][0] != "trade" or "--json" in one["words"]:
            yield from of_texts(one["stdout"], two["stdout"], "output", within)
        yield from of_data(one["files"], two["files"], "files", within)
        for name in {*one["files"]} & {*two["files"]}:
            if name.endswith((".json", ".csv")) and not name.startswith("kept/"):  # of one version
                texts = [(path.with_suffix("") / name).read_text() for path in (old, new)]
                yield from of_texts(*texts, name, within)


def lines_of(text: str) -> list[str]:
    """Return the lines of a text, without times, progress and what a pool says when it ends."""
    return [line for line in TIMES.sub("", text).splitlines() if not NOISE.match(line)]


def of_texts(old: str, new: str, where: str, within: float) -> Iterator[str]:
    """Yield how data, lines of CSV or the numbers of a table differ."""
    found: list[Any] = []
    for text in (old, new):
        if where.endswith(".csv"):
            rows = [line for line in lines_of(text) if not re.match("#.*version", line)]
            found.append([[cell.encode() for cell in row.split(",")] for row in rows])
        elif text[:1] in ("{", "["):
            # Numbers become bytes: no text, and as they were written.
            found.append(json.loads(text, parse_float=str.encode, parse_int=str.encode))
        else:
            found.append([one.encode() for one in NUMBER.findall("\n".join(lines_of(text)))])
    yield from of_data(*found, where, within)


def of_data(old: Any, new: Any, where: str, within: float) -> Iterator[str]:
    """Yield how plain data differ; of sentences the numbers count."""
    if isinstance(old, dict) and isinstance(new, dict):
        told = {*filter(ESTIMATES.search, {*old, *new})} if within else set[str]()
        names = {*old} - PASSING - told, {*new} - PASSING - told
        passing = names[1] - names[0] if within else set[str]()  # a later version may say more
        yield from (f"{where}.{name} comes or goes" for name in names[0] ^ names[1] - passing)
        for name in names[0] & names[1]:
            yield from of_data(old[name], new[name], f"{where}.{name}", within)
    elif isinstance(old, list) and isinstance(new, list):
        if len(old) != len(new):
            yield f"{where} has {len(old)} entries, now {len(new)}"
        for k, (one, two) in enumerate(zip(old, new, strict=False)):
            yield from of_data(one, two, f"{where}[{k}]", within)
    elif isinstance(old, str) and isinstance(new, str) and " " in old:
        yield from of_texts(f" {old}", f" {new}", where, within)
    elif (
        within and isinstance(old, bytes) and isinstance(new, bytes) and are_near(old, new, within)
    ):
        return
    elif type(old) is not type(new) or old != new:
        yield f"{where}: {old}, now {new}"


def are_near(old: bytes, new: bytes, within: float) -> bool:
    """Return True if two numbers differ by at most a part of the larger one."""
    try:
        one, two = float(old), float(new)
    except ValueError:
        return False
    return abs(one - two) <= within * max(abs(one), abs(two), LEAST)


def compare(options: argparse.Namespace) -> int:
    """Print a row for every answer that differs; 1 if there is one."""
    names = {one.name for folder in (options.old, options.new) for one in folder.glob("*.json")}
    names &= {f"{label}.json" for label in commands(options.only)} if options.only else names
    rows = 0
    for old, new in ((options.old / name, options.new / name) for name in sorted(names)):
        there = old.exists() and new.exists()
        found = sorted(differences(old, new, options.within)) if there else ["recorded once only"]
        rows += bool(found)
        if found:
            print(f"{old.stem}: {found[0][:300]} ({len(found)} in all)")
        if there and options.words:
            told = (json.loads(path.read_text()) for path in (old, new))
            texts = ("\n".join(lines_of(one["stderr"] + one["stdout"])) for one in told)
            words = (NUMBER.sub("#", text).split("\n") for text in texts)
            for line in difflib.unified_diff(*words, str(old), str(new), n=0, lineterm=""):
                print(line)
    print(f"{len(names)} commands, {rows} answers differ")
    return 1 if rows or not names else 0


def main() -> int:
    """Do what the command line says."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    both = argparse.ArgumentParser(add_help=False)
    both.add_argument("--only", default="", metavar="PATTERN", help="labels or words that fit it")
    parts = parser.add_subparsers(required=True)
    recording, comparing = (parts.add_parser(s, parents=[both]) for s in ("record", "compare"))
    recording.add_argument("folder", type=Path)
    recording.add_argument("--python", default=sys.executable, help="which has the package")
    recording.add_argument("--jobs", type=int, default=1, metavar="N", help="commands at a time")
    comparing.add_argument("old", type=Path)
    comparing.add_argument("new", type=Path)
    comparing.add_argument("--within", type=float, default=0.0, metavar="PART", help="of a number")
    comparing.add_argument("--words", action="store_true", help="show changed words, too")
    options = parser.parse_args()
    return record(options) if "folder" in options else compare(options)


if __name__ == "__main__":
    sys.exit(main())
