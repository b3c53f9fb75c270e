"""Customers into groups that one stop of the truck serves: k-means, ours, or an LLM's."""
