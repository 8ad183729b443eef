"""English and German texts of the HTML report of two epochs; both have the same keys."""

from __future__ import annotations

ENGLISH_EPOCHS_TEXTS: dict[str, str] = {
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


GERMAN_EPOCHS_TEXTS: dict[str, str] = {
    "epochs.title": "Zwei Epochen: {names}",
    "epochs.arrow": " bis ",
    "section.variances": "Ausgleichungen",
    "section.reference": "Referenzpunkte",
    "section.displacements": "Verschiebungen",
    "section.blocks": "Gemeinsame Bewegungen",
    "verdict.epochs.green": "kein Punkt hat sich signifikant bewegt",
    "verdict.epochs.shape": "die Referenzpunkte haben ihre Form behalten; keine Objekte wurden "
    "geprüft",
    "verdict.epochs.amber.one": "1 Punkt hat sich bewegt",
    "verdict.epochs.amber.many": "{n} Punkte haben sich bewegt",
    "verdict.epochs.red": "zweifelhafter Vergleich",
    "light.tested": "Geprüft",
    "light.tested.reference": "Gemeinsam auf ihre Form: {n} Referenzpunkte ({names}); gemeinsame "
    "Punkte sind Referenzpunkte, sofern sie nicht als Objekte genannt sind.",
    "light.tested.reference.none": "Keine Referenzpunkte: Das Datum der Ausgleichungen ist der "
    "Bezug, ohne Test.",
    "light.tested.objects": "Einzeln gegen den Bezug: {n} Punkte ({names}).",
    "light.tested.objects.none": "Kein Punkt wurde als Objekt geprüft: keiner ist genannt.",
    "light.tested.held": "In beiden Epochen festgehalten und ohne Test als stabil angenommen: "
    "{names}.",
    "light.tested.held.none": "",
    "light.tested.not_compared": "Nicht verglichen: {names}.",
    "light.tested.not_compared.none": "",
    "light.epochs.ended": "Iteration",
    "light.epochs.ended.yes": "Jede Ausgleichung kam zur Ruhe.",
    "light.epochs.ended.no": "Die Ausgleichung von {name} kam nicht zur Ruhe; ihre Koordinaten "
    "sind die, bei denen sie abbrach.",
    "light.epochs.global": "Globaltests",
    "light.epochs.global.fine": "Jede Ausgleichung passt zu ihren Standardabweichungen (χ², "
    "{level}): σ̂0 = {sigma0}.",
    "light.epochs.global.wrong": "Passt nicht zu ihren Standardabweichungen (χ², {level}): "
    "{names}. Die Tests der Verschiebungen teilen durch das gemeinsame σ̂0 beider Epochen; mehr "
    "steht im eigenen Protokoll.",
    "light.epochs.global.known": "Passt nicht zu ihren Standardabweichungen (χ², {level}): "
    "{names}. Die Tests der Verschiebungen nehmen σ0 = 1 als bekannt an und urteilen dann falsch.",
    "light.ratio": "Varianzen",
    "light.ratio.accepted": "Die Varianzen beider Epochen stimmen überein: ihr Verhältnis {ratio} "
    "liegt nicht über {critical}.",
    "light.ratio.rejected": "Die Varianzen der Epochen sind verschieden: ihr Verhältnis {ratio} "
    "liegt über {critical}. Eine Epoche ist ungenauer, als ihre Gewichte sagen.",
    "light.ratio.none": "Nicht verglichen: beide Epochen stehen in einer Ausgleichung, oder eine "
    "hat keine Redundanz.",
    "light.reference": "Referenzpunkte",
    "light.reference.kept": "Die {n} Referenzpunkte haben ihre Form behalten: T = {value}, "
    "kritischer Wert {critical}.",
    "light.reference.changed": "Die {n} Referenzpunkte haben ihre Form verändert (T = {value}, "
    "kritischer Wert {critical}). Ohne {left} haben die anderen sie behalten.",
    "light.reference.lost": "Die {n} Referenzpunkte haben ihre Form verändert (T = {value}, "
    "kritischer Wert {critical}), und keine Auswahl hat sie behalten: die Verschiebungen beziehen "
    "sich auf Punkte, die sich gegeneinander bewegt haben.",
    "light.reference.none": "Das Datum der Ausgleichungen ist der Bezug; keine Punkte wurden auf "
    "ihre Form geprüft.",
    "light.moved": "Verschiebungen",
    "light.moved.none": "Kein Punkt, der sich bewegt haben kann, hat es signifikant getan (α = "
    "{alpha} für jeden).",
    "light.moved.untested": "Kein Punkt wurde gegen den Bezug geprüft: Alle verglichenen Punkte "
    "sind stabile Referenzpunkte.",
    "light.moved.some.one": "1 Punkt hat sich signifikant bewegt (α = {alpha}): {names}. Die "
    "größte Verschiebung ist {size} ({largest}).",
    "light.moved.some.many": "{n} Punkte haben sich signifikant bewegt (α = {alpha} für jeden): "
    "{names}. Die größte Verschiebung ist {size} ({largest}).",
    "light.detectable": "Aufdeckbar",
    "light.detectable.text": "Eine Verschiebung von {best} ({best_name}) bis {worst} "
    "({worst_name}) wird mit {power} gefunden, in der Richtung, in der sie am schwersten zu "
    "finden ist.",
    "light.blocks": "Gemeinsame Bewegungen",
    "light.blocks.moved": "{points}: als Block bewegt ({model}).",
    "light.blocks.kept": "{points}: als Block nicht signifikant bewegt ({model}).",
    "light.blocks.unfit": "{points}: die Bewegung eines Blocks ({model}) erklärt die "
    "Verschiebungen nicht.",
    "model.rigid": "starr",
    "model.similarity": "ähnlich",
    "model.affine": "affin",
    "figure.compared": "verglichene Punkte",
    "figure.reference": "Referenzpunkte",
    "figure.stable": "stabil",
    "figure.moved": "bewegt",
    "figure.sigma_tests": "σ0 der Tests",
    "figure.freedom": "Freiheitsgrade von σ0",
    "known": "bekannt",
    "state.stable": "stabile Referenz",
    "state.left": "instabile Referenz",
    "state.moved": "bewegt",
    "state.kept": "nicht signifikant",
    "epochs.plan.one": "Lageplan von 1 verglichenen Punkt.",
    "epochs.plan.many": "Lageplan von {n} verglichenen Punkten.",
    "epochs.plan.regions": "Ellipsen von {level} stehen an den Enden der Verschiebungen. Ein "
    "Faktor vergrößert beide.",
    "epochs.plan.heights": "Nur Höhen: die Verschiebungen zeigen nach oben und unten, mit "
    "Intervallen von {level}.",
    "epochs.plan.click": "Ein Klick auf einen Punkt, eine Verschiebung oder eine Ellipse führt zu "
    "ihrer Zeile der Tabelle.",
    "epochs.block": "Block",
    "epochs.block_moved": "Block nach seiner gemeinsamen Bewegung",
    "adjustments.caption": "Die verglichenen Ausgleichungen",
    "ratio.caption": "Verhältnis der Varianzen",
    "steps.caption": "Kongruenztests der Referenzpunkte",
    "steps.note": "T ist die Quadratsumme, um die sich die Formen unterscheiden, geteilt durch "
    "ihre Freiheitsgrade und σ0². Die erste Zeile prüft alle.",
    "displacements.caption": "Verschiebungen gegen die stabilen Punkte",
    "displacements.note": "Stabile Punkte werden mit den anderen stabilen verglichen. a, b: "
    "Halbachsen der Ellipsen von {level}.",
    "displacements.note_standard": "Stabile Punkte werden mit den anderen stabilen verglichen. a, "
    "b: Halbachsen der Standardellipsen.",
    "blocks.caption": "Tests der gemeinsamen Bewegungen",
    "motions.caption": "Parameter der gemeinsamen Bewegungen",
    "strains.caption": "Hauptdehnungen",
    "col.epoch": "Epoche",
    "col.larger": "größere durch kleinere Varianz",
    "col.step": "Schritt",
    "col.left": "ausgeschieden",
    "col.back": "zurückgekehrt",
    "col.tested": "geprüfte Punkte",
    "col.fits": "passt",
    "col.moved": "bewegt",
    "col.length": "Länge",
    "col.detectable": "aufdeckbar",
    "col.block": "Block",
    "col.model": "Modell",
    "col.motion": "T der Bewegung",
    "col.fit": "T des Modells",
    "col.strain": "Dehnung",
    "yes": "ja",
    "no": "nein",
    "all": "alle",
    "help.t_epochs": "Testwert: gewichtete Quadratsumme der Verschiebung durch ihre "
    "Freiheitsgrade und σ0².",
    "help.p": "Wahrscheinlichkeit eines größeren Testwerts, wenn sich nichts bewegt hat.",
    "help.detectable": "Kleinste Verschiebung, die mit der Güte der Tests gefunden wird, in der "
    "Richtung, in der sie am schwersten zu finden ist.",
    "help.displacement": "Zweite minus erste Epoche, gegen die stabilen Punkte.",
    "help.sigma_d": "Standardabweichung der Verschiebung, mit dem σ0 der Tests.",
    "help.ellipse_d": "Halbachsen der Ellipse der Verschiebung, und Richtungswinkel der größeren, "
    "rechtsläufig von Nord.",
    "symbol.displacement": "d",
    "symbol.sigma_d": "σ",
    "symbol.t_epochs": "T",
    "symbol.p": "p",
    "symbol.detectable": "aufdeckbar",
    "symbol.ellipse_d": "a, b",
    "run.epochs_tests": "α = {alpha}, 1 − β = {power}",
    "js.region": "Ellipsen {level}",
    "js.moved": "signifikante Verschiebung",
    "js.kept": "Verschiebung, nicht signifikant",
    "js.scale_displacements": "Verschiebungen {factor}: {size}",
}
