"""What a log's recordings must pass before anything is answered from them."""
