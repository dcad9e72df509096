"""`mapfusion evaluate`: the paper's experiments, and the accept/reject study that it lacks, with ground truth."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from mapfusion.config import Profile
    from mapfusion.evaluation import Attempt, Generator, Study


class Maps(StrEnum):
    """Where the pairs come from."""

    paper = "paper"
    floor_plans = "floor-plans"
    both = "both"


class Profiles(StrEnum):
    """Who fuses them."""

    paper = "paper"
    default = "default"
    both = "both"


_GENERATORS: dict[Maps, tuple[Generator, ...]] = {
    Maps.paper: ("paper",),
    Maps.floor_plans: ("floor-plans",),
    Maps.both: ("paper", "floor-plans"),
}
_PROFILES: dict[Profiles, tuple[Profile, ...]] = {
    Profiles.paper: ("paper",),
    Profiles.default: ("default",),
    Profiles.both: ("paper", "default"),
}


def evaluate(
    pairs: Annotated[int, typer.Option(min=0, metavar="N", help="Pairs of one place, for each generator.")] = 200,
    negatives: Annotated[int, typer.Option(min=0, metavar="N", help="Pairs of two places, for each generator.")] = 200,
    generator: Annotated[
        Maps, typer.Option(help="Random maps as in the paper, or floor plans mapped by lidar robots.")
    ] = Maps.both,
    profile: Annotated[Profiles, typer.Option(help="Who fuses the pairs; both stand side by side.")] = Profiles.both,
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="Seed of everything random.")] = 0,
    jobs: Annotated[int, typer.Option(min=1, metavar="N", help="Processes. Never changes the result.")] = 1,
    plots: Annotated[Path | None, typer.Option(metavar="DIR", help="Draw charts into this folder, as PNG.")] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")] = False,
) -> None:
    """Measure the fusion of pairs with ground truth: recall, false merges, accuracy, MAE, confidence.

    Repeats the paper's experiments (4.1 alignment, 4.2 robot positions) against the exact transform, and adds what
    they lack: pairs of maps that have nothing to do with each other.
    """
    from mapfusion.evaluation import Study, figures
    from mapfusion_cli.evaluation_report import evaluation_json, evaluation_text, write_charts
    from mapfusion_cli.printing import show

    study = Study(
        generators=_GENERATORS[generator],
        num_related=pairs,
        num_unrelated=negatives,
        seed=seed,
        profiles=_PROFILES[profile],
    )
    attempts = _attempts(study, jobs, quiet=quiet)
    found = [figures(attempts, maps, who) for maps in study.generators for who in study.profiles]
    charts = [] if plots is None else write_charts(found, plots)
    if json:
        show(evaluation_json(study, found))
    elif not quiet:
        show(evaluation_text(found))
        if charts:
            show(f"{len(charts)} charts in {plots}")


def _attempts(study: Study, jobs: int, *, quiet: bool) -> list[Attempt]:
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor
    from contextlib import ExitStack

    import cv2

    from mapfusion.evaluation import run_study
    from mapfusion_cli.progress import StageProgress

    with ExitStack() as stack:
        executor = None
        if jobs > 1:
            # Not forked: OpenCV may run threads already, and a forked process would inherit their locks.
            executor = stack.enter_context(
                ProcessPoolExecutor(
                    jobs, multiprocessing.get_context("spawn"), initializer=cv2.setNumThreads, initargs=(1,)
                )
            )
        progress = stack.enter_context(StageProgress(quiet=quiet))
        progress.stage("pairs", 0, study.num_attempts)
        attempts = []
        for attempt in run_study(study, executor):
            attempts.append(attempt)
            progress.reached(len(attempts))
        return attempts
