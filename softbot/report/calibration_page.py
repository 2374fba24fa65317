"""The HTML report of a calibration: one self-contained page with curves, residuals, what was chosen and why.

It has the style sheet of a run's report and no script; figures stand in it as SVG. It refers to nothing outside itself.
"""

from __future__ import annotations

import io
import os
import re
from collections.abc import Iterable, Sequence
from html import escape
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import softbot
from calib.calibration import Calibration
from calib.figure import draw_residuals, draw_table
from calib.series_calibration import SeriesCalibration, Transfer
from calib.series_figure import draw_trials
from softbot.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; style-src 'unsafe-inline'; img-src data:">
<title>{title} · softbot calibration</title>
<style>
{style}
.card svg {{ display: block; width: 100%; height: auto; }}
td.number, th.number {{ text-align: right; }}
li {{ margin: 3px 0; }}
</style>
</head>
<body>
<header>
  <div class="name"><span>softbot calibration · <b>{title}</b></span></div>
  <h1>{headline}</h1>
  <ul class="facts">{facts}</ul>
</header>
<main>
{sections}
</main>
<footer><p><small>softbot {version}; {source}</small></p></footer>
</body>
</html>
"""


def write_calibration_page(
    calibration: Calibration | SeriesCalibration, path: Path, judged: Sequence[Transfer] = ()
) -> None:
    """Write the page, whole or not at all. Raises InputError where it cannot be written."""
    if path.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"{path}: a report ends in .html")
    partial = path.with_name(path.name + ".partial")
    try:
        partial.write_text(render_calibration(calibration, judged), encoding="utf-8")
        os.replace(partial, path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}; choose another place") from None


def render_calibration(calibration: Calibration | SeriesCalibration, judged: Sequence[Transfer] = ()) -> str:
    """The page as text."""
    report = calibration.report()
    recorded = isinstance(calibration, SeriesCalibration)
    sections = [_warnings(report)]
    if isinstance(calibration, SeriesCalibration):
        sections += [
            _card("Steps and releases, measured and predicted", _svg(draw_trials(calibration)), _band_words(report)),
            _card("Trials", _trial_table(report), "errors in % of each trial's full scale, root mean square"),
        ]
        if judged:
            sections.append(_card("Fitted on one trial, judged on another", _transfer_table(judged), "% of full scale"))
    else:
        sections += [
            _card(
                "Curves",
                _svg(draw_table(calibration)),
                "with 95 % bands: of the law (dark), of one more measurement (light)",
            ),
            _card("Residuals", _svg(draw_residuals(calibration)), "by trial; colour: chambers that were driven"),
            _card("Errors", _error_table(report), "in % of full scale"),
        ]
    sections += [
        _card("Parameters", _parameter_table(report), "with 95 % intervals"),
        _card("What was chosen, and why", _candidate_table(report, recorded), _why(report, recorded)),
        _list("What to measure next", [one["words"] for one in report.get("measure_next", ())]),
        _list("Assumed", report["assumptions"]),
    ]
    return _PAGE.format(
        title=escape(Path(calibration.table.source).name),
        headline=escape(_headline(report, recorded)),
        facts="".join(f"<li>{escape(fact)}</li>" for fact in _facts(report, recorded)),
        sections="\n".join(filter(None, sections)),
        style=resources.files("softbot.report").joinpath("report.css").read_text(encoding="utf-8"),
        version=escape(softbot.__version__),
        source=escape(calibration.table.source),
    )


def _headline(report: dict[str, Any], recorded: bool) -> str:
    if recorded:
        if report["loo_bend_percent"] is None:
            return (
                f"One trial is followed to {report['rms_bend_percent']:.1f} % of full scale; nothing tells how well "
                "another would be predicted"
            )
        return (
            f"Trials that were left out are predicted to {report['loo_raw_bend_percent']:.1f} % of full scale, and to "
            f"{report['loo_bend_percent']:.1f} % once one gain is refitted"
        )
    if any(text.startswith("lack of fit") for text in report["warnings"]):
        return "No fibre-reinforced law here explains this table"
    repeats = report["repeat_bend_percent"]
    return f"The {report['law']} wall leaves {report['rms_bend_percent']:.1f} % of full scale in bending" + (
        "" if repeats is None else f"; the table's own repeats differ by {repeats:.1f} %"
    )


def _facts(report: dict[str, Any], recorded: bool) -> list[str]:
    facts = [f"{report['law']} wall", f"{report['rows']} rows", f"full scale {report['full_scale_bend_deg']:.1f}°"]
    if recorded:
        facts += [f"{len(report['trials'])} trials", *(f"memory: {part}" for part in report["memory"])]
    elif report["lack_of_fit_p"] is not None:
        facts.append(f"lack-of-fit test p = {report['lack_of_fit_p']:.2f}")
    return facts


def _band_words(report: dict[str, Any]) -> str:
    coverage = report["band_coverage_percent"]
    return f"band: ±{report['band_percent']:.0f} % of full scale, 95 % of a trial that was left out" + (
        "" if coverage is None else f"; the other trials' band holds {coverage:.0f} % of their rows"
    )


def _why(report: dict[str, Any], recorded: bool) -> str:
    if recorded and report["loo_bend_percent"] is None:
        return "a single trial has nothing to choose by: the usual memory is taken"
    what = "trials" if recorded else "rows"
    return f"the simplest of those that predict {what} left out about as well as the best"


def _warnings(report: dict[str, Any]) -> str:
    return _list("What to know before using it", report["warnings"])


def _card(title: str, body: str, caption: str = "") -> str:
    small = f" <small>{escape(caption)}</small>" if caption else ""
    return f'<section class="card"><h2>{escape(title)}{small}</h2>\n{body}\n</section>'


def _list(title: str, texts: Iterable[str]) -> str:
    items = "".join(f"<li>{escape(text)}</li>" for text in texts)
    return _card(title, f"<ul>{items}</ul>") if items else ""


def _table(headings: Sequence[str], rows: Iterable[Sequence[str]], left: int = 1) -> str:
    """A table whose first `left` columns are words and the others numbers."""

    def cells(tag: str, values: Sequence[str]) -> str:
        return "".join(
            f"<{tag}{' class=number' if n >= left else ''}>{escape(value)}</{tag}>" for n, value in enumerate(values)
        )

    body = "".join(f"<tr>{cells('td', row)}</tr>" for row in rows)
    return f"<table><thead><tr>{cells('th', headings)}</tr></thead><tbody>{body}</tbody></table>"


def _parameter_table(report: dict[str, Any]) -> str:
    rows = []
    for name, one in report["parameters"].items():
        interval = f"{one['low']:.4g} … {one['high']:.4g}" if one["identified"] else "not determined"
        rows.append((name, f"{one['value']:.4g}", interval, "" if one["unit"] == "1" else one["unit"]))
    return _table(("parameter", "value", "95 % interval", "unit"), rows)


def _candidate_table(report: dict[str, Any], recorded: bool) -> str:
    rows: list[tuple[str, ...]] = []
    for n, one in enumerate(report["candidates"]):
        name = one["name"] + (" (chosen)" if n == 0 else "")
        if recorded:
            rows.append((name, str(one["coordinates"]), f"{one['rms_percent']:.1f}", _number(one["loo_percent"])))
        else:
            rows.append((name, str(one["coordinates"]), f"{one['loo_score']:.2f}"))
    headings = (
        ("law", "parameters", "fit [%]", "left out, one gain refitted [%]")
        if recorded
        else (
            "law",
            "parameters",
            "left out [measuring errors]",
        )
    )
    return _table(headings, rows)


def _trial_table(report: dict[str, Any]) -> str:
    rows = [
        (
            one["name"],
            ", ".join(map(str, one["driven"])),
            f"{one['full_scale_bend_deg']:.1f}",
            f"{one['rms_bend_percent']:.1f}",
            f"{one['scale']:.2f}",
            _number(one.get("left_out_percent")),
            _number(one.get("left_out_with_gain_percent")),
            str(one["gaps"]),
        )
        for one in report["trials"]
    ]
    headings = (
        "trial",
        "chambers",
        "full scale [°]",
        "fit, own scale",
        "scale",
        "left out",
        "one gain refitted",
        "gaps",
    )
    return _table(headings, rows, left=2)


def _transfer_table(judged: Sequence[Transfer]) -> str:
    rows = [
        (
            one.fitted,
            one.judged,
            *(f"{100.0 * share:.1f}" for share in (one.rms_fitted, one.rms_with_gain, one.rms_raw)),
            f"{100.0 * one.steady_difference:.1f}",
        )
        for one in judged
    ]
    headings = ("fitted on", "judged on", "fit", "one gain refitted", "nothing refitted", "steady states differ by")
    return _table(headings, rows, left=2)


def _error_table(report: dict[str, Any]) -> str:
    rows = []
    for kind, unit in (("bend", "deg"), ("length", "mm")):
        if f"rms_{kind}_percent" in report:
            shares = [report[f"{error}_{kind}_percent"] for error in ("rms", "loo", "repeat", "release_rms")]
            rows.append((kind, f"{report[f'full_scale_{kind}_{unit}']:.1f} {unit}", *map(_number, shares)))
    return _table(("", "full scale", "fit (rms)", "leave one out", "between repeats", "releases"), rows)


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.1f}"


def _svg(figure: Figure) -> str:
    """A figure as an SVG element: no declaration, no date, the same on every machine."""
    import matplotlib

    stream = io.StringIO()
    with matplotlib.rc_context({"svg.hashsalt": "softbot", "svg.fonttype": "none"}):
        figure.savefig(stream, format="svg", metadata={"Date": None})
    text = stream.getvalue()
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    widest = f"{100.0 * float(figure.get_figwidth()):.0f}px"
    return f'<div style="max-width: {widest}">{text[text.index("<svg") :]}</div>'
