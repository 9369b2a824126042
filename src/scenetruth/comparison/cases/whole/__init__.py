"""Cases that vary everything at once: scenes of the library."""
