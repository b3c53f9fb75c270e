"""For all tests: examples are counted, never timed, since machines are noisy."""

from hypothesis import settings

settings.register_profile("leeway", deadline=None)
settings.load_profile("leeway")
