SELECT t, source, target, label FROM hops
