// A look, or a whole panorama.
MATCH (e:Episode {id: $episode})
CREATE (e)-[:Made]->(:Observation {id: $id, episode: $episode, number: $number, step: $step, frame: $frame, angle: $angle, left: $left, width: $width})
