// Looks of an episode whose people were listed.
MATCH (:Episode)-[r:Listed]->(o:Look {episode_hash: UUID($hash)})
WHERE r.step <= $step
RETURN DISTINCT o.number AS look, o.frame AS frame, o.left AS left, o.width AS width
ORDER BY look
