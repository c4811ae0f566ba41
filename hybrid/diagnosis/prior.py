"""The prior beliefs of a diagnosis."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Prior:
    """What the search believes before any recording, for every arm and log."""

    # Log odds against an effect at a place, [nat]. An arm has some hundred places for
    # effects, and one to three of them hold a cause.
    cause: float = 7.0
    unknown: float = 9.0  # log odds against an unknown law at a joint, [nat]
    law_error: float = 0.03  # RMS error of a law of the library over that of the gap
    real_law_error: float = 0.1  # of a real law, which differs from all simple laws
    # RMS of what an event leaves around its time over that of its torque, at most; and
    # the share of its squares that a law foretells.
    event_error: float = 0.2
    solver_error: float = 0.002  # RMS difference of two simulators over the RMS torque
    # Relative errors of the links' numbers in the file that are tried. The second one
    # is typical, and that of all other numbers: friction that is farther off is a cause
    # of its own.
    file_errors: tuple[float, ...] = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
    file_factor: float = 2.0  # standard deviation from the typical one, as a factor
    unknown_size: float = 0.03  # RMS of an unknown law, in rated torque
    shortlist: int = 6  # candidates whose shapes are fitted in a step
    refined_share: float = 0.5  # their evidence over that of the best one, at least
    most_repeated: int = 3  # unknown laws, ripples at a joint; contacts in a recording
    # Share of a residual's squares by which the lower half of its band may exceed the
    # upper half in noise.
    slow_share: float = 0.33
    probable: float = 0.5  # probability above which a known effect is named
    in_class: float = 0.95  # of a cause and of those that may take its place, together
