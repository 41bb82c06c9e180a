SELECT text, t, track, t, track, anchor, text FROM names
