"""Records, the store that keeps them, the logs that become them, and the windows cut from them."""
