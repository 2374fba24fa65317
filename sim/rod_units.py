"""What of the rod's code another process may compile meanwhile: half of the work, called from the other half.

The types are told because callers are compiled before these are.
"""

from __future__ import annotations

from typing import Any, get_type_hints

import numba
from numba.core import types
from numba.core.typing import Signature

from sim.rod_contact import contact_rows, find_contacts
from sim.rod_energy import audit_energy
from sim.rod_forces import accelerations
from sim.rod_memory import Physics, carved_types
from sim.rod_placement import place_rod
from sim.rod_row import write_row

_LAYOUT, _STATE, _RULE, _CONTACTS, _WORK = carved_types()
_PHYSICS = numba.typeof(Physics(**{name: kind() for name, kind in get_type_hints(Physics).items()}))
_NUMBER = types.float64
_VECTOR, _ROWS, _BLOCK, _BLOCKS = (types.Array(types.float64, axes, "C") for axes in (1, 2, 3, 4))


def rod_units() -> list[tuple[Any, Signature]]:
    """Units and what they take and give, in the order in which one needs another."""
    return [
        (place_rod, types.none(_STATE, _PHYSICS, _RULE, _WORK, _LAYOUT, _NUMBER)),
        (
            accelerations,
            _NUMBER(_NUMBER, _ROWS, _VECTOR, _ROWS, _NUMBER, _NUMBER, _NUMBER, _RULE, _VECTOR, _BLOCK, _BLOCK, _ROWS),
        ),
        (
            find_contacts,
            types.boolean(
                _NUMBER, _NUMBER, _VECTOR, _VECTOR, _PHYSICS, _CONTACTS, _ROWS, _VECTOR, _ROWS, _ROWS, _ROWS, _ROWS
            ),
        ),
        (
            contact_rows,
            types.none(_NUMBER, _NUMBER, _PHYSICS, _CONTACTS, _VECTOR, _VECTOR, _BLOCK, _ROWS, _ROWS),
        ),
        (audit_energy, types.none(_STATE, _PHYSICS, _RULE, _CONTACTS, _WORK, _LAYOUT)),
        (write_row, types.none(_STATE, _PHYSICS, _RULE, _WORK, _LAYOUT, _VECTOR)),
    ]
