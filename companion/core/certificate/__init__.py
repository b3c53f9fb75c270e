"""Energy draw of an airframe as supported by days of flights, its envelope, and the monitor of that
envelope in flight."""
