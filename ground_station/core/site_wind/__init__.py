"""The wind over a site, estimated by one receiver: reports, excluded members, fronts, forecast."""
