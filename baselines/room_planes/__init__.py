"""This project's room method `room-planes`: an unseen room's planes, found in what is heard, on top of `room-lags`."""
