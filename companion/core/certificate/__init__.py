"""What days of flights support of an airframe's draw, inside which envelope, and a flight's watch
over that envelope."""
