"""Physics and control of ctr-station. This package uses no clock, thread, file or socket."""
