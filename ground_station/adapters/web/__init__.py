"""The live map over HTTP: server, access guard, event stream and page."""
