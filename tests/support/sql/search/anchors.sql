SELECT text, t, track, t, track, anchor FROM names
