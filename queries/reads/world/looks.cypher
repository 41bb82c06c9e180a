// Looks of an episode whose people were listed, in the order of the lists.
MATCH (:Episode)-[r:Listed]->(o:Look {episode_hash: UUID($hash)})
WHERE r.step <= $step
RETURN o.number AS look, o.frame AS frame, o.left AS left, o.width AS width, r.write AS written
ORDER BY written
