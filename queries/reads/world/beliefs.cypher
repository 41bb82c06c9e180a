// All that is believed in an episode, one row each: of a sighting the frame, of a relation the other one.
// (From the episode on, or to the names of people, the engine would scan edges and nodes of other episodes.)
MATCH (n:Entity {episode_hash: UUID($hash)})-[r:Sighted|Has|Related]->(:Observation:Entity)
WITH r.who AS id, r.whom AS other, r
WHERE r.current
