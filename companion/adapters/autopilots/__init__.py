"""MAVLink: links, codec, PX4 and ArduPilot, missions, parameters. Imports no logs or files."""
