"""Contact forces as a record has them, with what a test cares about changed."""

from vitac.evaluator.episodes.records import ContactForces, ForceFigures


def some_forces(peak_n: float, *, gels_n: tuple[float, float] = (30.0, 31.0), events: int = 0) -> ContactForces:
    part, left, right = (ForceFigures(peak_n=n, p95_n=n / 2, impulse_n_s=n / 10) for n in (peak_n, *gels_n))
    return ContactForces(
        part=part,
        gels=(left, right),
        over_force_n=40.0,
        over_force_events=events,
        largest_stretch=1.3,
        high_stretch=1.15,
    )
