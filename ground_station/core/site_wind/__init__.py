"""The wind over a site as one listener believes it: tellings, who is believed, fronts, forecast."""
