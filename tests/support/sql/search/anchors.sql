SELECT text, t, track, general, t, track, anchor FROM names
