"""What runs at a desk: replay, calibrate, fit-wind, and their pictures and reports."""
