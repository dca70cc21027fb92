"""Devices, loop, lab, recordings and commands of ctr-station."""
