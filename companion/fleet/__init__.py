"""What drones, trucks and the dispatcher share: messages, topics, commands. Imports the core."""
