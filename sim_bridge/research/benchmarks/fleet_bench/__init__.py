"""Fleet benchmark: desks with many vehicles that fly orders, all on one machine."""
