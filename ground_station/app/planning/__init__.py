"""Planning that needs files: estimates, clustering, missions for QGroundControl."""
