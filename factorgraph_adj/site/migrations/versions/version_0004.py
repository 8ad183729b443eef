"""Results of epochs in parts: what lists show, what concerns one point, and the rest."""

import json
from collections.abc import Sequence
from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"
branch_labels = None
depends_on = None

Result = dict[str, Any]
Number = sa.BigInteger().with_variant(sa.Integer(), "sqlite")
SUMMARY = (
    *("time", "problem", "counts", "converged", "reason", "sigma0", "sigma0_limits"),
    *("redundancy", "groups"),
)
FINDINGS = ("problem", "congruence")
LISTS = (("points", "name"), ("displacements", "name"), ("tests", "point"))

epochs = sa.table("epochs", sa.column("id"), sa.column("summary"), sa.column("result"))
point_results = sa.table("point_results", sa.column("epoch"), sa.column("point"), sa.column("data"))


def upgrade() -> None:
    """Change the tables, and part the results one after the other."""
    with op.batch_alter_table("epochs", schema=None) as batch_op:
        batch_op.add_column(sa.Column("summary", sa.Text(), nullable=True))
    op.create_table(
        "point_results",
        sa.Column("epoch", Number, nullable=False),
        sa.Column("point", sa.Text(), nullable=False),
        sa.Column("data", sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(["epoch"], ["epochs.id"], name=op.f("fk_point_results_epoch")),
        sa.PrimaryKeyConstraint("epoch", "point", name=op.f("pk_point_results")),
    )
    connection = op.get_bind()
    for key in _ids(connection):
        wanted = sa.select(epochs.c.result).where(epochs.c.id == key)
        summary, points, rest = _parted(json.loads(connection.execute(wanted).scalar_one()))
        change = sa.update(epochs).where(epochs.c.id == key)
        connection.execute(change.values(summary=_text(summary), result=_text(rest)))
        rows = [{"epoch": key, "point": n, "data": _text(x)} for n, x in points.items()]
        if rows:
            connection.execute(sa.insert(point_results), rows)


def downgrade() -> None:
    """Undo the change."""
    connection = op.get_bind()
    for key in _ids(connection):
        wanted = sa.select(epochs.c.summary, epochs.c.result).where(epochs.c.id == key)
        summary, rest = map(json.loads, connection.execute(wanted).one())
        own = sa.select(point_results.c.point, point_results.c.data)
        found = connection.execute(own.where(point_results.c.epoch == key))
        points = {point: json.loads(data) for point, data in found}
        result = _text(_joined(summary, points, rest))
        connection.execute(sa.update(epochs).where(epochs.c.id == key).values(result=result))
    op.drop_table("point_results")
    with op.batch_alter_table("epochs", schema=None) as batch_op:
        batch_op.drop_column("summary")


def _ids(connection: sa.Connection) -> Sequence[int]:
    """Return the ids of the epochs that have results."""
    wanted = sa.select(epochs.c.id).where(epochs.c.result.is_not(None))
    return connection.execute(wanted.order_by(epochs.c.id)).scalars().all()


def _parted(result: Result) -> tuple[Result, dict[str, Result], Result]:
    """Return summary, parts of points and rest of a result, as this revision has them."""
    findings = dict(result.get("findings") or {})
    summary = {k: result[k] for k in SUMMARY if k in result}
    summary["findings"] = {k: findings[k] for k in FINDINGS if k in findings}
    rest = {k: v for k, v in result.items() if k not in SUMMARY}
    points: dict[str, Result] = {}
    for name, key in LISTS:
        of = rest if name == "points" else findings
        for place, record in enumerate(of.get(name) or ()):
            points.setdefault(record[key], {}).setdefault(name, []).append([place, record])
        if name in of:
            of[name] = []
    for point, motion in (findings.get("motions") or {}).items():
        points.setdefault(point, {})["motions"] = motion
    if "motions" in findings:
        findings["motions"] = {}
    if "findings" in result:
        rest["findings"] = {k: v for k, v in findings.items() if k not in FINDINGS}
    return summary, points, rest


def _joined(summary: Result, points: dict[str, Result], rest: Result) -> Result:
    """Return the result of its parts."""
    result = rest | {k: v for k, v in summary.items() if k != "findings"}
    if "findings" in result:
        result["findings"] = findings = result["findings"] | summary["findings"]
        if "motions" in findings:
            findings["motions"] = {p: x["motions"] for p, x in points.items() if "motions" in x}
    for name, _ in LISTS:
        of = result if name == "points" else result.get("findings", {})
        placed = [pair for part in points.values() for pair in part.get(name, ())]
        if placed:
            of[name] = [record for _, record in sorted(placed, key=lambda pair: pair[0])]
    return result


def _text(part: Result) -> str:
    return json.dumps(part, ensure_ascii=False)
