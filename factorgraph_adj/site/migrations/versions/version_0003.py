"""States of monitors, so that a restart replays no epochs."""

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Change the tables."""
    op.create_table(
        "monitors",
        sa.Column("network", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("data", sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(["network"], ["networks.id"], name=op.f("fk_monitors_network")),
        sa.PrimaryKeyConstraint("network", name=op.f("pk_monitors")),
    )


def downgrade() -> None:
    """Undo the change."""
    op.drop_table("monitors")
