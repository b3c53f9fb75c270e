"""The desk's figures for Prometheus: as families of samples, as a page, over HTTP."""
