"""In-service monitor of the energy promises, with error bounds valid at any time.

Imports base, vehicle and wind.
"""
