"""Devices, control loop, virtual lab, recordings and commands of ctr-station."""
