"""German texts of the report of two epochs; `english_epochs` has the same keys."""

from __future__ import annotations

EPOCHS: dict[str, str] = {
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
