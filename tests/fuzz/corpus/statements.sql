SELECT * FROM annotations_boxes_2d ORDER BY frame, track LIMIT 3
SELECT sequence, count(*) FROM intervals_sightings GROUP BY sequence
SELECT * FROM sightings WHERE frame = $frame
SELECT * FROM read_csv('/etc/passwd')
SELECT * FROM read_text('/proc/self/environ')
SELECT * FROM '/etc/passwd'
COPY (SELECT 1) TO '/tmp/one.csv'
ATTACH '/tmp/x.db'
INSTALL httpfs
LOAD httpfs
SET enable_external_access = true
CREATE TABLE x AS SELECT 1
INSERT INTO predictions VALUES (1)
DROP VIEW predictions
SELECT 1; SELECT 2
WITH RECURSIVE t AS (SELECT 1 AS n UNION ALL SELECT n + 1 FROM t) SELECT sum(n) FROM t
SELECT repeat('x', 2000000000)
SELECT * FROM range(1000000000000) a, range(1000000000) b
SELECT getenv('HOME'), current_setting('temp_directory')
PRAGMA database_list
EXPLAIN ANALYZE SELECT 1
SELECT 'nan'::DOUBLE, 1/0, 170141183460469231731687303715884105727 + 1
