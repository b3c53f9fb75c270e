"""The truck-and-drones problem and its solvers. Compiled by numba: import it lazily."""
