"""Physics and control of ctr-station: no clock, thread, file or socket."""
