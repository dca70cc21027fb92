"""Page, REST and scene of ctr-station."""
