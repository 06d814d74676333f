"""Geodesic distances: by the heat method, exactly, or from the modes alone."""
