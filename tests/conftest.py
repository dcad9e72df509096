"""Property tests draw the same examples every time, and none fails for the time it takes: the machine may be busy."""

from hypothesis import HealthCheck, settings

settings.register_profile(
    "mapfusion", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow], database=None
)
settings.load_profile("mapfusion")
