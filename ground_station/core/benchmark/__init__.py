"""The published problem (mFSTSP) and an independent check of its schedules."""
