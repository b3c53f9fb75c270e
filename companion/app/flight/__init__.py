"""What runs on the vehicle: loop, standby, recorder. Imports no replay, calibration or wind_fit."""
