"""Run migrations on the connection that `factorgraph_adj.site.database` gives."""

from alembic import context

from factorgraph_adj.site.tables import metadata

if hasattr(context, "config"):  # alembic runs this file; it may be imported as well
    context.configure(
        connection=context.config.attributes["connection"],
        target_metadata=metadata,
        render_as_batch=True,
        transactional_ddl=True,
    )
    with context.begin_transaction():
        context.run_migrations()
