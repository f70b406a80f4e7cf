"""What methods that learn are built from: networks, encodings, losses, targets and the training loop.

In come the training rows (`PasDataset`), a budget and a seed. A `ChannelField` turns transmitters and carriers into
power maps; `LearnedMethod` trains it, predicts with it, and saves and loads all of its state.
"""
