"""What `mapfusion evaluate` found, as a table, as JSON and as charts."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict
from pathlib import Path

import cv2

from mapfusion.errors import LogWriteError
from mapfusion.evaluation import Bin, Figures, Quantiles, Study
from mapfusion.evaluation.attempts import RIGHT_CELLS, RIGHT_DEG
from mapfusion.version import __version__
from mapfusion_cli.plots import Axis, Image, Series, line_chart

RIGHT = (
    f"right: the middle of the source's known area less than {RIGHT_CELLS:g} cells and the rotation "
    f"less than {RIGHT_DEG:g} degrees off the truth"
)

_TITLES = {"paper": "the paper's generator", "floor-plans": "floor plans mapped by lidar robots"}
_LABEL_WIDTH, _COLUMN_WIDTH = 46, 24


def evaluation_text(found: Sequence[Figures]) -> str:
    """Tables with the profiles side by side, one for each generator."""
    blocks = [_table(_of_generator(found, generator)) for generator in dict.fromkeys(f.generator for f in found)]
    return "\n\n".join([*blocks, RIGHT])


def evaluation_json(study: Study, found: Sequence[Figures]) -> str:
    """Everything that the table and the charts show."""
    results = [
        {**asdict(f), "recall": f.recall, "precision": f.precision, "false_merge_rate": f.false_merge_rate}
        for f in found
    ]
    content = {"version": __version__, "study": asdict(study), "criterion": RIGHT, "results": results}
    return json.dumps(content, indent=2)


def write_charts(found: Sequence[Figures], folder: Path) -> list[Path]:
    """Draws all charts into a folder, which is made where it is missing; gives the files.

    Raises:
        LogWriteError: A file cannot be written.
    """
    written = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, chart in _charts(found).items():
            path = folder / f"{name}.png"
            path.write_bytes(cv2.imencode(".png", chart)[1].tobytes())
            written.append(path)
    except OSError as error:
        raise LogWriteError(f"{folder}: cannot write the charts: {error.strerror}") from error
    return written


def _of_generator(found: Iterable[Figures], generator: str) -> list[Figures]:
    return [f for f in found if f.generator == generator]


def _table(found: Sequence[Figures]) -> str:
    first = found[0]
    lines = [
        f"{_TITLES[first.generator]}: {first.num_related} pairs of one place, {first.num_unrelated} of two",
        _row("", [f.profile for f in found]),
    ]

    def add(label: str, cell: Callable[[Figures], str]) -> None:
        lines.append(_row(label, [cell(f) for f in found]))

    add("joined and right (recall)", lambda f: _share(f.num_right, f.num_related))
    add("joined and wrong", lambda f: _share(f.num_wrong, f.num_related))
    add("false merges of two places", lambda f: _share(f.num_false_merges, f.num_unrelated))
    add("precision of all joins", lambda f: "-" if f.precision is None else f"{100.0 * f.precision:.1f} %")
    add("right candidate, joined or not", lambda f: _share(f.num_right_candidates, f.num_related))
    add("joined, corners within 5 cells", lambda f: _share(f.num_right_by_corners, f.num_related))
    lines += _bin_rows("recall at overlap", "{:.2f} to {:.2f}", [f.recall_by_overlap for f in found])
    lines += _bin_rows("recall at rotation", "{:.0f} to {:.0f} degrees", [f.recall_by_rotation for f in found])
    add("corner error of the right, cells (4.1)", lambda f: _spread(f.corner_error_cells))
    add("centre error of the right, cells", lambda f: _spread(f.centre_error_cells))
    add("angle error of the right, degrees", lambda f: _spread(f.angle_error_deg, 3))
    add("robot position error of all joins, cells (4.2)", lambda f: _spread(f.robot_error_cells))
    add("robot position error of all joins, m (4.2)", lambda f: _spread(f.robot_error_m, 3))
    add("scale of right candidates", lambda f: _range(f.scale_right, 3))
    add("MAE of right candidates", lambda f: _range(f.mae_right))
    add("MAE of wrong candidates", lambda f: _range(f.mae_wrong))
    add("MAE of two places", lambda f: _range(f.mae_unrelated))
    if any(f.published for f in found):
        lines.append(_row("the published code's gate on the same candidates", []))
        published = [f.published for f in found]
        for label, cells in (
            ("joined and right", [p and _share(p.num_right, first.num_related) for p in published]),
            ("joined and wrong", [p and _share(p.num_wrong, first.num_related) for p in published]),
            ("false merges of two places", [p and _share(p.num_false_merges, first.num_unrelated) for p in published]),
            ("error of right candidates", [p and _range(p.error_right) for p in published]),
            ("error of wrong candidates", [p and _range(p.error_wrong) for p in published]),
            ("error of two places", [p and _range(p.error_unrelated) for p in published]),
        ):
            lines.append(_row(f"    {label}", [cell or "-" for cell in cells]))
    lines.append(_row("refused, of one place + of two places", []))
    for gate in sorted({r.gate for f in found for r in f.refusals}):
        counts = [{r.gate: f"{r.num_related} + {r.num_unrelated}" for r in f.refusals} for f in found]
        lines.append(_row(f"    {gate}", [by_gate.get(gate, "-") for by_gate in counts]))
    return "\n".join(lines)


def _bin_rows(title: str, edges: str, bins_of_profiles: Sequence[Sequence[Bin]]) -> list[str]:
    rows = [_row(title, [])]
    for bins in zip(*bins_of_profiles, strict=True):
        label = "    " + edges.format(bins[0].low, bins[0].high)
        rows.append(_row(label, [_share(b.num_right, b.num) for b in bins]))
    return rows


def _row(label: str, cells: Iterable[str]) -> str:
    return (f"  {label:{_LABEL_WIDTH}}" + "".join(f"{cell:>{_COLUMN_WIDTH}}" for cell in cells)).rstrip()


def _share(part: int, whole: int) -> str:
    return f"{part}/{whole} = {100.0 * part / whole:.1f} %" if whole else "-"


def _spread(q: Quantiles | None, digits: int = 2) -> str:
    return "-" if q is None else f"{q.median:.{digits}f}, p95 {q.p95:.{digits}f}"


def _range(q: Quantiles | None, digits: int = 1) -> str:
    return "-" if q is None else f"{q.median:.{digits}f} ({q.p05:.{digits}f} to {q.p95:.{digits}f})"


def _charts(found: Sequence[Figures]) -> dict[str, Image]:
    charts = {}
    share = Axis("share of the pairs that are joined and right", 0.0, 1.0)
    for generator in dict.fromkeys(f.generator for f in found):
        profiles, title = _of_generator(found, generator), _TITLES[generator]
        charts[f"{generator}_recall_by_overlap"] = line_chart(
            f"Recall by overlap: {title}",
            Axis("overlap of the maps", 0.0, 1.0),
            share,
            [Series(f.profile, _ratios(f.recall_by_overlap)) for f in profiles],
        )
        charts[f"{generator}_recall_by_rotation"] = line_chart(
            f"Recall by rotation: {title}",
            Axis("rotation between the maps, degrees", 0.0, 180.0),
            share,
            [Series(f.profile, _ratios(f.recall_by_rotation)) for f in profiles],
        )
        charts[f"{generator}_roc"] = line_chart(
            f"Joins by threshold of the confidence: {title}",
            Axis("share of the pairs of two places that are joined", 0.0, 0.3),
            share,
            [Series(f.profile, _roc(f), markers=False) for f in profiles],
        )
        charts[f"{generator}_reliability"] = line_chart(
            f"Reliability of the confidence: {title}",
            Axis("confidence", 0.0, 1.0),
            Axis("share of the candidates that are right", 0.0, 1.0),
            [
                *(Series(f.profile, _ratios(f.reliability)) for f in profiles),
                Series("as it should be", [(0.0, 0.0), (1.0, 1.0)], markers=False, reference=True),
            ],
        )
        for f in profiles:
            charts[f"{generator}_mae_{f.profile}"] = line_chart(
                f"MAE, profile {f.profile}: {title}",
                Axis("MAE, grey levels", 0.0, 100.0),
                Axis("share of the candidates below", 0.0, 1.0),
                [
                    Series("right", _cumulative(f.mae_right)),
                    Series("wrong", _cumulative(f.mae_wrong)),
                    Series("two places", _cumulative(f.mae_unrelated)),
                    Series("the paper's limit", [(20.0, 0.0), (20.0, 1.0)], markers=False, reference=True),
                ],
            )
    return charts


def _ratios(bins: Iterable[Bin]) -> list[tuple[float, float]]:
    return [(b.mean, b.ratio) for b in bins if b.mean is not None and b.ratio is not None]


def _roc(f: Figures) -> list[tuple[float, float]]:
    return [(p.false_merge_rate, p.recall) for p in f.roc if p.false_merge_rate is not None and p.recall is not None]


def _cumulative(q: Quantiles | None) -> list[tuple[float, float]]:
    if q is None:
        return []
    return [(q.p05, 0.05), (q.p25, 0.25), (q.median, 0.5), (q.p75, 0.75), (q.p95, 0.95)]
