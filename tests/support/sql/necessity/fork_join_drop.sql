SELECT f.text, f.t, one.label, two.label, f.track, one.target, two.target
FROM fits f
JOIN hops one ON one.t = f.t AND one.source = f.track
JOIN hops two ON two.t = f.t AND two.source = f.track AND two.label > one.label AND two.target <> one.target
