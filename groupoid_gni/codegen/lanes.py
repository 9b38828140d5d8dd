"""Several members of an ensemble at once: one program over W lanes, as a job that can be sent away.

Every lane computes the bits it would compute alone (``step_kernel``). A job holds the text of the
machine code and arrays, nothing of the user's, so that it can be pickled and run in any process.
"""

from __future__ import annotations

import ctypes
import time
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from groupoid_gni.array_types import FloatArray
from groupoid_gni.codegen.machine import MachineCode, host_has
from groupoid_gni.outcomes import Outcome

_UNUSED = int(Outcome.INTERRUPTED)


@dataclass(frozen=True)
class LaneJob:
    """A stretch of a run of W members, lanes last: arrays (entries, W).

    source : LLVM IR of the program over W lanes.  row_size : numbers saved per node and lane.
    parameters, state, memory : as ``StepRunner.advance`` takes them.
    first, count, every : in stages.  controls : (steps, inputs, W), or None.
    used : lanes that hold a member; the others are frozen.
    """

    source: str
    row_size: int
    parameters: FloatArray
    state: FloatArray
    memory: FloatArray
    first: int
    count: int
    every: int
    used: int
    controls: FloatArray | None = None


@dataclass(frozen=True)
class LaneResult:
    """What a job leaves: state, memory, saved rows (nodes, row, W), codes (W,), loop seconds."""

    state: FloatArray
    memory: FloatArray
    rows: FloatArray
    codes: np.ndarray
    seconds: float


def widest_lanes() -> int:
    """Lanes that fill a vector register twice at most: 8 with 512-bit registers, otherwise 4."""
    return 8 if host_has("avx512f") else 4


@lru_cache(maxsize=32)
def _advance(source: str, controlled: bool) -> Any:
    kinds = [*[ctypes.c_void_p] * 5, *[ctypes.c_int64] * 3]
    kinds += [ctypes.c_void_p] if controlled else []
    return MachineCode(source).function("advance", *kinds, returns=ctypes.c_int64)


def run_lane_job(job: LaneJob) -> LaneResult:
    """Do a job; the interpreter lock is released while it runs."""
    lanes = job.state.shape[1]
    saved = (job.first + job.count) // job.every - job.first // job.every
    rows = np.empty((saved, job.row_size, lanes))
    status = np.zeros((2, lanes), dtype=np.int64)
    status[0, job.used :] = _UNUSED
    parameters, state, memory = (
        np.array(array, order="C") for array in (job.parameters, job.state, job.memory)
    )
    arrays = [parameters, state, memory, rows, status]
    sizes = (job.first, job.count, job.every)
    advance = _advance(job.source, job.controls is not None)
    more = () if job.controls is None else (np.ascontiguousarray(job.controls),)
    began = time.perf_counter()
    advance(*[a.ctypes.data for a in arrays], *sizes, *[a.ctypes.data for a in more])
    seconds = time.perf_counter() - began
    return LaneResult(state, memory, rows, status[0, : job.used].copy(), seconds)
