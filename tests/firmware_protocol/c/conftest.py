"""The C reference, compiled once for all tests, with functions that code many messages in one call."""

from __future__ import annotations

import ctypes
import os
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from firmware_protocol.c_names import c_type, payload, snake_case
from firmware_protocol.c_physical import to_physical_name, to_raw_name
from firmware_protocol.c_reference import compile_c_reference
from firmware_protocol.spec import MessageSpec, spec

Ints = NDArray[np.int64]
Doubles = NDArray[np.float64]
Bytes = NDArray[np.uint8]
REPLAY = Path(__file__).parent / "replay.c"


class CCodec:
    """The compiled reference. Rows are messages of one kind, columns its signals but Crc and Counter.

    A signal's value stands in `whole` where its raw count is its unit, in `physical` where it is scaled.
    """

    def __init__(self, library: ctypes.CDLL) -> None:
        self.library = library

    def encode(self, message: MessageSpec, whole: Ints, physical: Doubles) -> tuple[Bytes, Bytes]:
        """Frames [n, 8], protected with the row modulo 16 as counter, and which rows were accepted [n]."""
        frames, accepted = np.zeros((len(whole), 8), np.uint8), np.zeros(len(whole), np.uint8)
        self._call(f"batch_encode_{message.name}", len(whole), whole, physical, frames, accepted)
        return frames, accepted

    def pack(self, message: MessageSpec, raw: Ints) -> tuple[Bytes, Bytes]:
        """Frames [n, 8] without protection of raw counts, and which rows were accepted [n]."""
        frames, accepted = np.zeros((len(raw), 8), np.uint8), np.zeros(len(raw), np.uint8)
        self._call(f"batch_pack_{message.name}", len(raw), raw, frames, accepted)
        return frames, accepted

    def decode(self, message: MessageSpec, frames: Bytes) -> tuple[Ints, Doubles, Bytes, Bytes]:
        """`whole`, `physical`, which rows were accepted, and which have a right CRC."""
        rows, columns = len(frames), len(payload(message))
        whole, physical = np.zeros((rows, columns), np.int64), np.zeros((rows, columns))
        accepted, protected = np.zeros(rows, np.uint8), np.zeros(rows, np.uint8)
        self._call(f"batch_decode_{message.name}", rows, frames, whole, physical, accepted, protected)
        return whole, physical, accepted, protected

    def _call(self, name: str, rows: int, *arrays: np.ndarray) -> None:
        assert all(array.flags.c_contiguous for array in arrays)
        self.library[name](ctypes.c_size_t(rows), *(ctypes.c_void_p(array.ctypes.data) for array in arrays))


def batch_source() -> str:
    """C functions over arrays for each message; they touch nothing but the reference's public functions."""
    lines = ["#include <stddef.h>", '#include "softbot_e2e.h"', '#include "softbot_physical.h"', ""]
    for message in spec().messages:
        lines += _batch_of(message)
    return "\n".join(lines)


def _batch_of(message: MessageSpec) -> list[str]:
    index, member = f"SOFTBOT_MESSAGE_{snake_case(message.name).upper()}", f"of.{snake_case(message.name)}"
    signals = list(enumerate(payload(message)))
    prototypes = [
        f"void batch_encode_{message.name}(size_t rows, const int64_t *whole, const double *physical, uint8_t *frames, "
        "uint8_t *accepted)",
        f"void batch_decode_{message.name}(size_t rows, const uint8_t *frames, int64_t *whole, double *physical, "
        "uint8_t *accepted, uint8_t *protected)",
        f"void batch_pack_{message.name}(size_t rows, const int64_t *raw, uint8_t *frames, uint8_t *accepted)",
    ]
    lines = [f"{each};" for each in prototypes]
    lines += [prototypes[2], "{", "    for (size_t row = 0; row < rows; row++) {"]
    lines += [f"        softbot_signals_t signals = {{.index = {index}}};"]
    for column, signal in signals:
        at, field = f"row * {len(signals)} + {column}", f"signals.{member}.{snake_case(signal.name)}"
        lines.append(f"        {field} = ({c_type(signal)})raw[{at}];")
    lines += ["        accepted[row] = softbot_pack(&signals, &frames[8 * row]);", "    }", "}"]
    unused = ["    (void)whole;", "    (void)physical;"]  # a message may have none of the one or of the other
    lines += [prototypes[0], "{", *unused, "    for (size_t row = 0; row < rows; row++) {"]
    lines += [f"        softbot_signals_t signals = {{.index = {index}}};", "        bool good = true;"]
    for column, signal in signals:
        at, field = f"row * {len(signals)} + {column}", f"signals.{member}.{snake_case(signal.name)}"
        if signal.whole:
            lines.append(f"        {field} = ({c_type(signal)})whole[{at}];")
        else:
            lines.append(f"        good = {to_raw_name(message, signal)}(physical[{at}], &{field}) && good;")
    lines += [
        "        good = good && softbot_pack(&signals, &frames[8 * row]);",
        "        if (good) {",
        f"            softbot_e2e_protect(&softbot_messages[{index}], &frames[8 * row], (uint8_t)(row % 16u));",
        "        }",
        "        accepted[row] = good;",
        "    }",
        "}",
        prototypes[1],
        "{",
        *unused,
        "    for (size_t row = 0; row < rows; row++) {",
        "        softbot_signals_t signals;",
        f"        accepted[row] = softbot_unpack({index}, &frames[8 * row], &signals);",
        f"        protected[row] = softbot_e2e_check(&softbot_messages[{index}], &frames[8 * row]);",
    ]
    for column, signal in signals:
        at, field = f"row * {len(signals)} + {column}", f"signals.{member}.{snake_case(signal.name)}"
        if signal.whole:
            lines.append(f"        whole[{at}] = (int64_t){field};")
        else:
            lines.append(f"        physical[{at}] = {to_physical_name(message, signal)}({field});")
    return [*lines, "    }", "}", ""]


@pytest.fixture(scope="session")
def c_library(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    """The reference with the functions above, compiled for this machine.

    C_REFERENCE_OPTIONS in the environment stands in place of -O2 (sanitizers, coverage), and C_REFERENCE_FOLDER in
    place of a temporary folder, which has to be there and empty.
    """
    named = os.environ.get("C_REFERENCE_FOLDER")
    folder = Path(named) if named else tmp_path_factory.mktemp("c")
    (folder / "batch.c").write_text(batch_source(), encoding="utf-8")
    options = os.environ.get("C_REFERENCE_OPTIONS", "-O2").split()
    return ctypes.CDLL(str(compile_c_reference(folder, options, [folder / "batch.c", REPLAY])))


@pytest.fixture(scope="session")
def c_codec(c_library: ctypes.CDLL) -> CCodec:
    """The C codec and protection."""
    return CCodec(c_library)
