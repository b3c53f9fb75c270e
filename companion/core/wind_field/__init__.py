"""Wind over a site from the reports of all members. Imports wind and base."""
