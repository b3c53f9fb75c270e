"""Long work side by side: processes of this machine, or a Ray cluster, with one behaviour."""
