"""The solver of one episode's beliefs, as the agent asks it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from jrdb_avr.schema.answers import Answer
from jrdb_avr.schema.beliefs import episode_key
from jrdb_avr.schema.method import Question
from jrdb_avr.schema.plan import Plan
from jrdb_avr.schema.rules import Rules

if TYPE_CHECKING:
    from jrdb_avr.agent.beliefs.solver import Belief
    from jrdb_avr.agent.beliefs.world_model import World
    from jrdb_avr.queries.beliefs.graph import WorldGraph
    from jrdb_avr.queries.compiler import Rows


@dataclass(frozen=True)
class BeliefSolver:
    """Solves plans over the beliefs of the episode with this key."""

    graph: WorldGraph
    key: str
    choices: tuple[str, ...]
    rules: Rules

    def check(self, plan: Plan) -> None:
        """Raises PlanError for a plan that cannot be compiled."""
        from jrdb_avr.queries.compiler import find_believed

        find_believed(plan)

    def weigh(self, plan: Plan, rows: Rows) -> Belief:
        """What the beliefs come to, told by the episode itself, `rows`, without asking the engine."""
        from jrdb_avr.agent.beliefs.solver import weigh_beliefs

        return weigh_beliefs(rows, plan, self.rules)

    def solve(self, plan: Plan, rows: Rows) -> Belief:
        """What the beliefs, `rows`, come to, by the compiled plan."""
        from jrdb_avr.agent.beliefs.solver import solve_beliefs

        return solve_beliefs(self.graph, self.key, plan, self.rules, rows)

    def guess(self, plan: Plan, rows: Rows) -> Belief | None:
        """What is read of who comes nearest to being the target."""
        from jrdb_avr.agent.beliefs.solver import best_guess

        return best_guess(self.graph, self.key, plan, self.rules, rows)

    def answer(self, plan: Plan, belief: Belief) -> Answer | None:
        """The answer that is read from the beliefs, None where there is none or no choice says it."""
        from jrdb_avr.agent.beliefs.solver import answer_of

        return answer_of(plan, belief, self.choices)

    def fault(self, plan: Plan, belief: Belief, proposed: Answer, entity: str) -> str:
        """Why a final answer is not legal, "" where it is."""
        from jrdb_avr.agent.beliefs.solver import legal

        return legal(plan, belief, proposed, entity, self.choices)


def beliefs_of(world: World, question: Question) -> BeliefSolver:
    """The solver of a question's episode."""
    return BeliefSolver(world.graph, episode_key(world.run_id, question.question_id), question.choices, Rules())
