"""pytest plugin: the fixture `inject_fault`, for fault-injection tests of a sequencer in a few lines.

pytest finds it by itself where softbot is installed. It imports nothing of the program until a test asks for it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from softbot.campaign.injection import Injected


@pytest.fixture(scope="session")
def inject_fault() -> Callable[..., Injected]:
    """`inject_fault("rupture", chamber=1)` runs a robot that loses it; see `softbot.campaign.injection.inject`."""
    from softbot.campaign.injection import inject

    return inject
