"""The mathematics of ctr-station."""
