"""The tests, a package so that processes which they start import what the tests share."""
