"""The learned estimator: network, loss, augmentation, and its use on windows."""
