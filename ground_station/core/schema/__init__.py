"""The data of a day: its file, its orders, its plan, and what has become of them."""
