-- Reasons for which candidates were refused, most frequent reason of each template first.
SELECT family, template, rule, sum(candidates)::BIGINT AS candidates
FROM rejected
WHERE kind = 'count'
GROUP BY family, template, rule
ORDER BY family, template, candidates DESC, rule;
