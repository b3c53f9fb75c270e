"""Ground heights and the clearance of flights from the ground. Imports base only."""
