"""What is believed of gaps before any recording."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Prior:
    """What the search for an explanation believes, on every arm and in every log.

    Attributes:
        cause: Odds against one effect at one place, [nat]: an arm has some hundred
            places for an effect, and one to three of them hold a cause.
        unknown: Odds against an unknown law of one joint, [nat].
        inexact: Part of a gap's RMS by which the true law differs from the one that the
            library has for it.
        misfit: The same of laws that no library has: real friction differs from all of
            its laws, and is no unknown law for that.
        solver: Part of a torque's RMS by which no two simulators agree.
        file: Relative errors of a file's numbers that are tried.
        file_factor: By which their typical error may be another than the second of
            these, as one standard deviation.
        size: RMS of an unknown law, in rated torque.
        shortlist: Candidates whose shapes are fitted, each time one is sought.
        refined: Part of the best candidate's worth that another one has at least, which
            fitted shapes may raise above it.
        repeated: Largest number of unknown laws at a joint, of contacts, and of ripples
            at a joint.
        coloured: Part of a residual's squares by which the lower half of its band may
            exceed the upper one in noise.
        alike: Probability from which on an effect may stand in another's place.
    """

    cause: float = 10.0
    unknown: float = 12.0
    inexact: float = 0.03
    misfit: float = 0.1
    solver: float = 0.002
    file: tuple[float, ...] = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
    file_factor: float = 2.0
    size: float = 0.03
    shortlist: int = 6
    refined: float = 0.5
    repeated: int = 3
    coloured: float = 0.33
    alike: float = 0.01
