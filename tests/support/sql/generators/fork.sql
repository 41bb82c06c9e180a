SELECT t, a, b, c FROM forks
