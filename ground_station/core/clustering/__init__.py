"""Groups of customers that one stop of the truck serves: by k-means, k-medoids, or an LLM."""
