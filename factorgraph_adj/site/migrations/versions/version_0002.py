"""Sets of instruments: when each was measured."""

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Change the tables."""
    op.create_table(
        "measured_sets",
        sa.Column("id", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("network", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("epoch", sa.Integer(), nullable=False),
        sa.Column("instrument", sa.String(length=200), nullable=False),
        sa.Column("begin", sa.Float(precision=53), nullable=False),
        sa.Column("end", sa.Float(precision=53), nullable=False),
        sa.Column("round", sa.Integer(), nullable=False),
        sa.ForeignKeyConstraint(
            ["network"], ["networks.id"], name=op.f("fk_measured_sets_network")
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_measured_sets")),
    )
    with op.batch_alter_table("measured_sets", schema=None) as batch_op:
        batch_op.create_index("ix_measured_sets_end", ["network", "instrument", "end"])
        batch_op.create_index("ix_measured_sets_epoch", ["network", "epoch"])


def downgrade() -> None:
    """Undo the change."""
    op.drop_table("measured_sets")
