"""Reflecting planes found in power maps: transmitters seen in them are sources of their own."""
