"""The exceptions and warnings of the library.

Every message says what was found, where, and how to mend it. The classes also derive from the
built-in exception a NumPy user would expect, so ``except ValueError`` keeps working.
"""

from __future__ import annotations

from typing import Any


class GNIError(Exception):
    """Base class of every exception raised on purpose by this library."""


class InputError(GNIError, ValueError):
    """An argument has a wrong type, shape or value."""


class NotComposableError(InputError):
    """Two arrows do not meet: target(first) differs from source(then)."""


class MetricMismatchError(InputError):
    """A metric states one matrix at the identity and computes with another.

    Attributes
    ----------
    stated, computed : ndarray, shape (d, d)
        The two matrices, in the frame of the group.
    """

    def __init__(self, message: str, stated: Any = None, computed: Any = None) -> None:
        super().__init__(message)
        self.stated = stated
        self.computed = computed


class RecordingError(GNIError, TypeError):
    """A user's function did something that cannot be recorded symbolically."""


class StepFailure(GNIError, RuntimeError):  # noqa: N818 (a failure, not a programming error)
    """The integration stopped before its end.

    Attributes
    ----------
    result : Trajectory, or None from ``next_arrow``
        Everything that was computed up to the last good step.
    """

    def __init__(self, message: str, result: Any = None) -> None:
        super().__init__(message)
        self.result = result


class TrajectoryFileError(GNIError, OSError):
    """A file does not hold a trajectory of this library, or only a part of one."""


class GNIWarning(UserWarning):
    """Base class of the library's warnings."""


class DependentConstraintsWarning(GNIWarning):
    """Some constraint rows depend linearly on others and were left out."""


class ParasiticModeWarning(GNIWarning):
    """The (-1)^k mode of a two-step method has left its O(h^2) bound.

    Attributes
    ----------
    result : Trajectory
        The run, for those who turn warnings into errors.
    """

    def __init__(self, message: str, result: Any = None) -> None:
        super().__init__(message)
        self.result = result


class RescuedStepsWarning(GNIWarning):
    """Some steps were solved only at a second try and may have jumped to another solution.

    Attributes
    ----------
    result : Trajectory
        The run; ``result.rescued_steps`` counts all second tries.
    """

    def __init__(self, message: str, result: Any = None) -> None:
        super().__init__(message)
        self.result = result


class SurprisingStepWarning(GNIWarning):
    """A step ended far from where the steps before it pointed: it is not resolved, or has jumped.

    Attributes
    ----------
    result : Trajectory
        The run; ``result.surprise`` says how far, ``result.surprising_step`` where.
    """

    def __init__(self, message: str, result: Any = None) -> None:
        super().__init__(message)
        self.result = result


class BrokenLawError(GNIError, AssertionError):
    """An object breaks a law it must obey.

    Attributes
    ----------
    report : LawReport
        Every law that was tried, with the smallest counterexample of each that failed.
    """

    def __init__(self, message: str, report: Any = None) -> None:
        super().__init__(message)
        self.report = report


class BrokenLawWarning(GNIWarning):
    """As BrokenLawError, for checks that only warn, and for laws that only advise.

    Attributes
    ----------
    report : LawReport
    """

    def __init__(self, message: str, report: Any = None) -> None:
        super().__init__(message)
        self.report = report
