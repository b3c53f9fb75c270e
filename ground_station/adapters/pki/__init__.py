"""A fleet's public key infrastructure: its authority, and what each member gets in its folder."""
