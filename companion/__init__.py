"""The program on the companion computer: estimates the wind, keeps the return budget, flies."""
