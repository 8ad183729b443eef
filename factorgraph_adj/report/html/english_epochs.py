"""English texts of the report of two epochs; `german_epochs` has the same keys."""

from __future__ import annotations

EPOCHS: dict[str, str] = {
    "epochs.title": "Two epochs: {names}",
    "epochs.arrow": " to ",
    "section.variances": "Adjustments",
    "section.reference": "Reference points",
    "section.displacements": "Displacements",
    "section.blocks": "Common motions",
    "verdict.epochs.green": "no point moved significantly",
    "verdict.epochs.shape": "the reference points kept their shape; no objects were tested",
    "verdict.epochs.amber.one": "1 point moved",
    "verdict.epochs.amber.many": "{n} points moved",
    "verdict.epochs.red": "doubtful comparison",
    "light.tested": "What was tested",
    "light.tested.reference": "Together, for a change of shape: {n} reference points ({names}); "
    "common points are reference points unless they are named as objects.",
    "light.tested.reference.none": "No reference points: the datum of the adjustments is the "
    "reference, without a test.",
    "light.tested.objects": "One by one against the reference: {n} points ({names}).",
    "light.tested.objects.none": "No point was tested as an object: none is named.",
    "light.tested.held": "Held in both epochs, and taken as stable without a test: {names}.",
    "light.tested.held.none": "",
    "light.tested.not_compared": "Not compared: {names}.",
    "light.tested.not_compared.none": "",
    "light.epochs.ended": "Iteration",
    "light.epochs.ended.yes": "Every adjustment came to rest.",
    "light.epochs.ended.no": "The adjustment of {name} did not come to rest; its coordinates are "
    "those where it stopped.",
    "light.epochs.global": "Global tests",
    "light.epochs.global.fine": "Each adjustment fits its standard deviations (χ², {level}): σ̂0 "
    "= {sigma0}.",
    "light.epochs.global.wrong": "Does not fit its standard deviations (χ², {level}): {names}. "
    "The tests of displacements divide by σ̂0 of both epochs; its own protocol has more.",
    "light.epochs.global.known": "Does not fit its standard deviations (χ², {level}): {names}. "
    "The tests of displacements take σ0 = 1 as known, and judge wrongly then.",
    "light.ratio": "Variances",
    "light.ratio.accepted": "The variances of both epochs agree: their ratio {ratio} is not above "
    "{critical}.",
    "light.ratio.rejected": "The variances of the epochs differ: their ratio {ratio} is above "
    "{critical}. One epoch is less accurate than its weights say.",
    "light.ratio.none": "Not compared: both epochs stand in one adjustment, or one has no "
    "redundancy.",
    "light.reference": "Reference points",
    "light.reference.kept": "The {n} reference points kept their shape: T = {value}, critical "
    "{critical}.",
    "light.reference.changed": "The {n} reference points changed their shape (T = {value}, "
    "critical {critical}). Without {left} the others kept theirs.",
    "light.reference.lost": "The {n} reference points changed their shape (T = {value}, critical "
    "{critical}), and no set of them kept it: the displacements refer to points that moved "
    "against each other.",
    "light.reference.none": "The datum of the adjustments is the reference; no points were tested "
    "for their shape.",
    "light.moved": "Displacements",
    "light.moved.none": "No point that may have moved did so significantly (α = {alpha} for each).",
    "light.moved.untested": "No point was tested against the reference: all compared points are "
    "stable reference points.",
    "light.moved.some.one": "1 point moved significantly (α = {alpha}): {names}. The largest "
    "displacement is {size} ({largest}).",
    "light.moved.some.many": "{n} points moved significantly (α = {alpha} for each): {names}. The "
    "largest displacement is {size} ({largest}).",
    "light.detectable": "Detectable",
    "light.detectable.text": "A displacement of {best} ({best_name}) to {worst} ({worst_name}) is "
    "found with {power}, in the direction in which it is hardest to find.",
    "light.blocks": "Common motions",
    "light.blocks.moved": "{points}: moved as a block ({model}).",
    "light.blocks.kept": "{points}: did not move significantly as a block ({model}).",
    "light.blocks.unfit": "{points}: the motion of a block ({model}) does not explain the "
    "displacements.",
    "model.rigid": "rigid",
    "model.similarity": "similarity",
    "model.affine": "affine",
    "figure.compared": "points compared",
    "figure.reference": "reference points",
    "figure.stable": "stable",
    "figure.moved": "moved",
    "figure.sigma_tests": "σ0 of the tests",
    "figure.freedom": "degrees of freedom of σ0",
    "known": "known",
    "state.stable": "stable reference",
    "state.left": "unstable reference",
    "state.moved": "moved",
    "state.kept": "not significant",
    "epochs.plan.one": "Plan of 1 compared point.",
    "epochs.plan.many": "Plan of {n} compared points.",
    "epochs.plan.regions": "Ellipses of {level} stand at the ends of the displacements. One "
    "factor exaggerates both.",
    "epochs.plan.heights": "Heights alone: displacements point up and down, with intervals of "
    "{level}.",
    "epochs.plan.click": "A click on a point, a displacement or an ellipse goes to its row in the "
    "table.",
    "epochs.block": "block",
    "epochs.block_moved": "block after its common motion",
    "adjustments.caption": "The adjustments that were compared",
    "ratio.caption": "Ratio of the variances",
    "steps.caption": "Congruence tests of the reference points",
    "steps.note": "T is the sum of squares by which the shapes differ, divided by its degrees of "
    "freedom and σ0². The first row tests all of them.",
    "displacements.caption": "Displacements against the stable points",
    "displacements.note": "Stable points are compared with the other stable ones. a, b: semi-axes "
    "of {level} ellipses.",
    "displacements.note_standard": "Stable points are compared with the other stable ones. a, b: "
    "semi-axes of standard ellipses.",
    "blocks.caption": "Tests of the common motions",
    "motions.caption": "Parameters of the common motions",
    "strains.caption": "Principal strains",
    "col.epoch": "epoch",
    "col.larger": "larger over smaller variance",
    "col.step": "step",
    "col.left": "left",
    "col.back": "came back",
    "col.tested": "points tested",
    "col.fits": "fits",
    "col.moved": "moved",
    "col.length": "length",
    "col.detectable": "detectable",
    "col.block": "block",
    "col.model": "model",
    "col.motion": "T of the motion",
    "col.fit": "T of the model",
    "col.strain": "strain",
    "yes": "yes",
    "no": "no",
    "all": "all",
    "help.t_epochs": "Test value: weighted square sum of the displacement over its degrees of "
    "freedom and σ0².",
    "help.p": "Probability of a larger test value if nothing moved.",
    "help.detectable": "Smallest displacement that is found with the power of the tests, in the "
    "direction in which it is hardest to find.",
    "help.displacement": "Second minus first epoch, against the stable points.",
    "help.sigma_d": "Standard deviation of the displacement, with the σ0 of the tests.",
    "help.ellipse_d": "Semi-axes of the ellipse of the displacement, and azimuth of the larger "
    "one, clockwise from north.",
    "symbol.displacement": "d",
    "symbol.sigma_d": "σ",
    "symbol.t_epochs": "T",
    "symbol.p": "p",
    "symbol.detectable": "detectable",
    "symbol.ellipse_d": "a, b",
    "run.epochs_tests": "α = {alpha}, 1 − β = {power}",
    "js.region": "ellipses {level}",
    "js.moved": "significant displacement",
    "js.kept": "displacement, not significant",
    "js.scale_displacements": "displacements {factor}: {size}",
}
