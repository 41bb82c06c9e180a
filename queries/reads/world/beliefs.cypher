// All that is believed in an episode of what is wanted, and what is said of it as one text.
// (From the episode on, or to the names of people, the engine would scan edges and nodes of other episodes.)
MATCH (n:Entity {episode_hash: UUID($hash)})-[r:Sighted|Has|Related]->(:Observation:Entity)
WITH r, concat(r.name, '=', r.value, '@', CAST(r.first AS STRING), CAST(r.frame AS STRING)) AS said
WHERE r.current AND said IN $wanted
