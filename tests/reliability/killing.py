"""Killing the command while it runs."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

from tests.reliability.running import read_whole

LAUNCH = "import sys; from mapfusion_cli.main import run; run(sys.argv[1:])"


def started(*arguments: object) -> subprocess.Popen[str]:
    """`mapfusion` in a process of its own, which ignores no signal, whatever the tests were started by."""
    return subprocess.Popen(
        [sys.executable, "-c", LAUNCH, *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        stdin=subprocess.DEVNULL,
        preexec_fn=_heed_signals if os.name == "posix" else None,
    )


def _heed_signals() -> None:
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)


def whole_run_s(recording: Path, output: Path) -> float:
    """How long a run takes that nobody disturbs."""
    began_s = time.perf_counter()
    with started("replay", recording, output, "-q", "--force") as process:
        assert process.wait() == 0
    return time.perf_counter() - began_s


def complaints(recording: Path, folder: Path, count: int, seed: int) -> tuple[list[str], int]:
    """Kills runs at random times, by SIGKILL, SIGTERM and SIGINT by turns, with one job and with two by turns.

    Returns:
        What was wrong, and how many runs were killed before their end.
    """
    chosen = random.Random(seed)
    output = folder / "fused.mcap"
    whole_run_s(recording, output)  # the first one may have inner loops to compile
    lasts_s = whole_run_s(recording, output)
    wrong, num_killed = [], 0
    for number in range(count):
        sent = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)[number % 3]
        jobs = 1 + number // 3 % 2
        with started("replay", recording, output, "-q", "--force", "--jobs", jobs) as process:
            time.sleep(chosen.uniform(0.0, lasts_s))
            process.send_signal(sent)
            _, err = process.communicate()
        num_killed += process.returncode != 0
        left = [item.name for item in folder.glob(f".*-{process.pid}-*.partial")]
        if left and sent is not signal.SIGKILL:
            wrong.append(f"{sent.name}: left {left}")
        is_starting = sent is signal.SIGINT and ", in run\n" not in err  # the interpreter's own words, before our first
        if "Traceback" in err and not is_starting:
            wrong.append(f"{sent.name}: {err}")
        try:
            read_whole(output)
        except Exception as error:
            wrong.append(f"{sent.name}: the output is not whole: {error!r}")
    whole_run_s(recording, output)
    left = [item.name for item in folder.glob(".*.partial")]
    if left:
        wrong.append(f"not removed by the next run: {left}")
    return wrong, num_killed
