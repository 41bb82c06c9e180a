"""Stored plans, compiled to Cypher and asked of the store's graph: they find the stored people, times and answer."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from jrdb_avr.engine.validate.stored import Difference, Stored, decoded, read_plans, short
from jrdb_avr.queries.compiler.find import compile_find
from jrdb_avr.queries.compiler.mapping import SCENE
from jrdb_avr.queries.compiler.solve import PlanQuery, solve
from jrdb_avr.queries.graph.handle import Graph
from jrdb_avr.queries.store import Store
from jrdb_avr.schema.errors import PlanError
from jrdb_avr.schema.plan import Plan
from jrdb_avr.schema.rules import Rules


def ask_compiled(
    store: Store, questions: Sequence[Stored], rules: Rules, advance: Callable[[int], None] = lambda steps: None
) -> list[Difference]:
    """Compile the stored plans and ask the store's graph; `advance` is told how many are looked for.

    Raises StoreError where there is no sound graph, LockedError while it is written.
    """
    plans, differences = read_plans(questions)
    asked: list[tuple[Stored, Plan]] = []
    for question, plan, _ in plans:
        try:
            compile_find(plan, SCENE)
            asked.append((question, plan))
        except PlanError as error:
            differences.append(Difference(question.question_id, "compiled", str(error)))
    with Graph.open(store.graph_path, read_only=True) as graph:
        scoped = [PlanQuery(plan, question.sequence) for question, plan in asked]
        solutions = solve(graph, SCENE, scoped, rules, advance=advance)
    for (question, plan), solution in zip(asked, solutions, strict=True):
        bound = decoded(question.row["bindings"])
        if solution.outcome != "defined":
            found = f"{solution.outcome}, and not {short(question.said)}"
        elif solution.answer != question.said:
            found = f"answers {short(solution.answer)}, and not {short(question.said)}"
        elif solution.people[plan.target] != question.row["target_track"]:
            found = f"finds person {solution.people[plan.target]}, and not {question.row['target_track']}"
        elif dict(solution.people) | dict(solution.times) != bound:
            found = f"binds {short(dict(solution.people) | dict(solution.times))}, and not {short(bound)}"
        else:
            continue
        differences.append(Difference(question.question_id, "compiled", found))
    return differences
