"""Code shared by drones, trucks and the dispatcher: messages, topics, commands."""
