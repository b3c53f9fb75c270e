"""The live map over HTTP: a server on loopback, what it refuses, its stream and its page."""
