-- Rules that refused candidates in each template, with the number of refused candidates, largest number first.
SELECT family, template, rule, sum(candidates)::BIGINT AS candidates
FROM rejected
GROUP BY family, template, rule
ORDER BY family, template, candidates DESC, rule;
