"""What all rooms stand on: checks, records, files, clocks; private."""
