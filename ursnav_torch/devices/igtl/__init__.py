"""OpenIGTLink: messages as bytes, and a server."""
