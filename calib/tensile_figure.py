"""Pictures of the library of silicones: each tensile test with the laws fitted to it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from calib.fit_materials import tensile_tests
from calib.tensile_test import FITTED_TO_STRAIN, SMALL_STRAINS, TensileTest, fit_laws
from softbot.errors import InputError

_COLOURS = {"neo-hookean": "#0072b2", "mooney-rivlin": "#d55e00", "yeoh": "#009e73", "gent": "#cc79a7"}


def save_figures(folder: Path) -> list[Path]:
    """One PNG a silicone in `folder`, which is made if need be. Raises InputError where nothing can be written."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        return [_save(test, folder / f"{test.name.replace(' ', '_')}.png") for test in tensile_tests()]
    except OSError as error:
        raise InputError(f"{folder}: cannot be written: {error.strerror}; choose another place") from None


def _save(test: TensileTest, path: Path) -> Path:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    whole, near = figure.subplots(1, 2)
    fits = fit_laws(test)
    slope_Pa, error_Pa = test.small_strain_modulus_Pa()
    for axes, largest in ((whole, test.strain[-1]), (near, 0.3)):
        strain = np.linspace(0.0, largest, 120)
        for fit in reversed(fits):
            best = fit is fits[0]
            label = f"{fit.law}: {fit.modulus_Pa / 1e3:.0f} kPa, rms {fit.rms_percent:.1f} %"
            axes.plot(
                100.0 * strain,
                fit.stress_Pa(strain) / 1e3,
                color=_COLOURS[fit.law],
                linewidth=2.0 if best else 1.0,
                linestyle="-" if best else "--",
                label=f"{label} (taken)" if best else label,
            )
        seen = test.strain <= largest
        axes.plot(100.0 * test.strain[seen], test.stress_Pa[seen] / 1e3, "k.", markersize=4, label="test")
        axes.set_xlabel("engineering strain (%)")
        axes.set_ylabel("engineering stress (kPa)")
    whole.axvspan(100.0 * FITTED_TO_STRAIN, 100.0 * test.strain[-1], color="0.93", label="not fitted")
    whole.set_ylim(top=1.15 * test.stress_Pa.max() / 1e3, bottom=min(0.0, 1.2 * test.stress_Pa.min() / 1e3))
    whole.legend(fontsize=7)
    near.axvspan(100.0 * SMALL_STRAINS[0], 100.0 * SMALL_STRAINS[1], color="0.93")
    near.set_title(f"slope of the test in the grey: {slope_Pa / 1e3:.0f} ± {error_Pa / 1e3:.0f} kPa", fontsize=9)
    figure.suptitle(f"{test.name}: tensile test and laws", fontsize=11)
    figure.savefig(path, dpi=130)
    return path
