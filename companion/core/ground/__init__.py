"""Heights of the ground, and how flights keep clear of it. Imports base only."""
