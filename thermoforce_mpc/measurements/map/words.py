"""Words in names of signals, in ten languages of Europe; abbreviations of building automation and of heat pumps.

Abbreviations are those of ASHRAE's and Project Haystack's point lists (OA-T, ZN-T, SAT, VLV), grey-box models write Ti,
Ta, Ph and Ps (Bacher and Madsen 2011, doi 10.1016/j.enbuild.2011.02.005); BT1, BT50 and the like are NIBE's sensors.
"""

from __future__ import annotations

import re
import unicodedata
from functools import lru_cache
from itertools import pairwise

# Tag: (whole words, beginnings or ends and parts of compound words of five letters and more).
_WORDS: dict[str, tuple[str, str]] = {
    "outdoor": (
        "out outdoor outdoors outside oa oat oda osa osat ambient amb ext exterior external extern exterieur "
        "exterieure aussen aussenluft ta te tout toa tamb text tex tdb drybulb weather wetter meteo weer buiten "
        "oataverage toutdoor outdoortemp tdrybul at dehors gevel "
        "esterno esterna esterni fuori exteriores externa afuera "
        "ute utomhus utetemp utegivare uteluft ude udendors udeluft utendors ulko ulkona ulkoilma udetemp",
        "aussen buiten exterieur outdoor outside ambienta ambientt tambient drybul weather witterung wetter estern "
        "utomhus udendors utendors ulkolamp ulkoilm utetemp udetemp",
    ),
    "room": (
        "room rooms zone zn znt rm rmt space spt indoor inside innen inne interior interieur int in tin tint ti "
        "tr traum binnen raum zimmer living kitchen bath bad bed bedroom bathroom office hall hallway salon "
        "sejour chambre cuisine bureau couloir woonkamer slaapkamer keuken badkamer kantoor kamer zolder attic "
        "keller basement studio nursery guest gast dining lounge corridor lobby meeting conference classroom "
        "stube eg og dg ug cellar loft tzone troom tair tz zat sdb wohnen schlafen kuche kueche buro buero flur "
        "diele house home maison huis haus building apartment wohnung flat tenant suite lab library lib kids "
        "child children parents eltern piece thermostat ambiance ambiante woning interne "
        "stanza soggiorno cucina bagno ufficio salotto corridoio interno interna ambiente "
        "sala habitacion dormitorio cocina oficina pasillo despacho vivienda comedor "
        "rum rom vardagsrum sovrum kok badrum barnrum inomhus stue kokken sovevaerelse badevaerelse vaerelse kontor "
        "indendors inde soverom kjokken innendors romtemp rumtemp innetemp olohuone makuuhuone keittio kylpyhuone "
        "eteinen huone sisa sisalla sisailma",
        "zimmer wohn schlaf kinder kuche kueche badezimmer bureau chambre kamer keuken room raum buero innen "
        "binnen interieur indoor spacetemp office kitchen "
        "soggiorn habitac dormitor vardagsrum sovrum "
        "badrum vaerelse soverom kjokken kokken huone sisalamp stuetemp innetemp inomhus innendors indendors "
        "romtemp rumtemp",
    ),
    "temperature": (
        "t temp temps temperature temperatur temperatuur tmp ti ta te tin tout tint text tamb tz tr th degc degf "
        "celsius rt sat rat mat dat oat lwt ewt znt rmt spt zat tzone troom tair tdb toa tex traum tdrybul thermo "
        "hws hwr chws chwr tsup tret tvl trl istwert "
        "temperatura "
        "lampotila",
        "temperat temp lampotil",
    ),
    "setpoint": (
        "sp stp setp set setpoint setpt stpt target targ soll sollwert solltemp consigne cons ingesteld gewenst "
        "streefwaarde setpunt instelling desired wunsch csp hsp clgsp htgsp htsp clsp zsp tset thset tcset tsp "
        "tsoll wunschtemperatur doel gewuenscht vorgabe occclgsp occhtgsp eff sptrn sollt gewenste ingestelde "
        "impostata impostato consigna deseada deseado objetivo desiderata desiderato "
        "borvarde onskad onsket indstillet innstilt installd asetus asetusarvo tavoite haluttu settpunkt saetpunkt",
        "setpoint sollwert solltemp consigne streef instelwaarde wunschtemp settemp targettemp tempset vorgabe "
        "gewenst ingesteld "
        "impostat consigna desider borvarde onskad "
        "onsket asetusarv tavoit settpunkt saetpunkt",
    ),
    "lower": (
        "lower min minimum tmin unten untere hsp htgsp htsp thset occhtgsp minima minimo inferiore inferior",
        "lower minimal",
    ),
    "upper": (
        "upper max maximum tmax obere csp clgsp clsp tcset occclgsp massima massimo superiore superior maxima maximo",
        "upper maximal",
    ),
    "supply": (
        "supply sup sat sa dat da flow vorlauf vl depart aller aanvoer lwt hws chws leaving discharge zuluft "
        "inlet tsup tvl flowtemp soufflage inblaas pulsion "
        "mandata impulsion "
        "framledning fremlob fremlop turledning menovesi meno tilluft",
        "vorlauf aanvoer supply zuluft discharge soufflage pulsion flowtemp mandata impulsion framledning fremlob "
        "fremlop turledn menoves tilluft",
    ),
    "return": (
        "return ret retour rat ra rl rucklauf ruecklauf hwr chwr ewt entering abluft tret trl returntemp reprise "
        "ritorno retorno "
        "retur returledning paluu paluuvesi franluft",
        "rucklauf ruecklauf retour return abluft ritorno retorno returledn paluu franluft",
    ),
    "water": (
        "water wasser eau buffer puffer tank brine sole evaporator evap condenser cond refrigerant kaeltemittel "
        "hotgas heissgas heater hhw chw hw mixed mat ma exhaust fortluft abgas flue slab ballon speicher storage "
        "hx coil outlet mixing source quelle glycol collector kollektor cellartank "
        "acqua agua accumulo deposito "
        "vatten vand vann vesi akkumulator ackumulator varaaja",
        "puffer speicher wasser water ballon buffer heissgas fortluft condens verdampf brine ackumulat akkumulat "
        "varaaja",
    ),
    "hot water": (
        "dhw ww warmwasser ecs tapwater brauchwasser trinkwasser warmwater sww boilerwater dhwt cylinder geyser "
        "legionella shower dusche "
        "acs acquacalda aguacaliente sanitaria "
        "varmvatten varmtvann varmtvand brugsvand tappevann tappvarmvatten kayttovesi lamminvesi vvb lkv",
        "warmwasser brauchwasser trinkwasser tapwater warmwater hotwater warmtapwater eauchaude varmvatten "
        "varmtvann varmtvand brugsvand kayttoves lamminves",
    ),
    "valve": (
        "valve vlv vp ventil stellventil stellung stellwert stellgrosse stellgroesse stellsignal stellantrieb "
        "vanne klep klepstand afsluiter trv opening ouverture oeffnung offnung hv rv htgvlv clgvlv reheat rhv "
        "rhvlv ventilstellung ventilposition vannenposition servo actuator aktor vlvo "
        "valvola valvula apertura "
        "venttiili venttiilin shunt",
        "ventil valve vanne klepst stellwert stellgr stellsig stellantr valvol valvul venttiil",
    ),
    "level": (
        "u level modulation modul mod modulating stage stufe demand cmd command co lvl duty speed drehzahl freq "
        "frequency frequenz frequence toerental vitesse compressor verdichter compresseur pump pumpe pompe pomp "
        "burner brenner bruleur brander relay relais switch schalter position pos heater heizstab hp heatpump "
        "active aktiv ove output fan boiler waermepumpe warmepumpe wp pac warmtepomp ketel chaudiere kessel "
        "heizung heizen chauffage verwarming heat heating htg stat status run running enable betrieb onoff on "
        "state signal cool cooling clg climatisation koeling kuhlung kuehlung kuehlen "
        "velocita velocidad compressore compresor pompa bomba bruciatore quemador riscaldamento calefaccion "
        "caldaia caldera "
        "comp compr kompressor kompressori styrsignal styresignal frekvens taajuus nopeus varvtal hastighet pumppu "
        "uppvarmning oppvarming opvarmning lammitys panna kedel kjele kattila brannare poltin demand vd",
        "modul verdicht compress drehzahl frequen brenner stufe pumpe burner circul umwalz umwaelz toerental drehz "
        "riscald calefac kompressor styrsign styresign frekven taajuus",
    ),
    "power": (
        "power pwr p pel watt watts w kw leistung puissance vermogen php pwp elec electric electrical elektrisch "
        "electrique load last strom stroom wattage pe phvac pheat pheating pcomp aufnahmeleistung "
        "verbrauchsleistung demandkw draw "
        "potenza potencia "
        "effekt teho",
        "power leistung puissance vermogen potenza potencia eleffekt",
    ),
    "energy": (
        "energy energie kwh wh mwh btu verbrauch consumption consommation verbruik conso zahler zaehler compteur "
        "meter teller meterstand zahlerstand zaehlerstand arbeit total totalizer kwhtot "
        "energia consumo contatore contador "
        "consumed energi energiforbruk forbrug forbruk forbrukning kulutus malare matare mittari kbtu mmbtu therms "
        "therm gj",
        "energy energie zaehler zahlerst meterst verbrauch consomm verbruik energia contator forbrug forbruk "
        "kulutus malerst matarst",
    ),
    "heat": (
        "heat warme waerme chaleur warmte thermal thermisch thermique q qh qheat phi ph heatflow heizleistung wmz "
        "heatmeter qdot pth phea qhea thermischvermogen "
        "calore calor termica termico "
        "varme lampo fjernvarme fjarrvarme kaukolampo",
        "warmemeng waermemeng heizleist waermeleist warmeleist heatout thermal calor fjernvarme fjarrvarme kaukolamp",
    ),
    "gas": (
        "gas gaz erdgas gasmeter gaszaehler",
        "erdgas gasz",
    ),
    "electric": (
        "el elec electric electrical elektrisch electrique pel stroom strom php pwp pe "
        "elettrica elettrico electrica electrico "
        "elektrisk sahko elforbrug elforbruk stromforbruk",
        "elektr electr strom elettr sahko",
    ),
    "heating machine": (
        "hp heatpump wp warmepumpe waermepumpe pac warmtepomp heater heating heizung chauffage verwarming boiler "
        "kessel ketel chaudiere heizstab hvac ahu compressor verdichter baseboard radiator convector heat furnace "
        "ac split klima clim airco chiller php pwp phvac pheat pheating pcomp htg "
        "riscaldamento calefaccion caldaia caldera radiatore radiador "
        "varmepump varmepumpe varmepumpen varmpump lampopumppu ilmalampopumppu maalampopumppu elpatron "
        "uppvarmning oppvarming opvarmning lammitys panna kedel kjele kattila patteri varmekabel comp compr aux",
        "pompe warmepump waermepump heatpump warmtepomp heizung chauffage verwarm radiat klima riscald calefac "
        "varmepump lampopump varmpump",
    ),
    "cooling": (
        "cool cooling clg chw kuhlung kuehlung kuehlen kuhlen kuhl kalte kaelte froid climatisation clim koeling "
        "koel airco ac chiller klima clgvlv "
        "raffrescamento raffreddamento refrigeracion freddo climatizzatore "
        "kyla kylning koling kjoling jaahdytys",
        "kuhl kuehl koel froid climatis kaelte raffre refriger jaahdyt kjoling",
    ),
    "sun": (
        "sun solar irradiance irrad irradiation ghi glohor hglohor global radiation globalstrahlung strahlung "
        "einstrahlung sonne rayonnement ensoleillement straling zonnestraling instraling pyranometer pyrano ps "
        "isol igh solrad solradiation solarradiation shortwave poa isolation glorad zon soleil is sol gsol hsol "
        "radiazione radiacion irraggiamento solare irradiancia irradianza "
        "sol solinstralning solindstraling solstraling auringonsateily",
        "irradi strahlung radiation rayonnement straling solar ensoleil radiazion radiacion irragg solinstral "
        "solindstr sateily stralning",
    ),
    "part of the sun": (
        "dni dhi diffuse diffus diffuus direct direkt beam normal azimuth elevation zenith altitude above rising "
        "setting",
        "diffus azimut",
    ),
    "pv": (
        "pv photovoltaic photovoltaik wechselrichter inverter einspeisung erzeugung ertrag production yield "
        "zonnepanelen panneaux opbrengst feedin export array "
        "produced solceller solcelle aurinkopaneeli aurinkosahko",
        "photovol wechselr zonnepan einspeis erzeug solcell aurinkopan",
    ),
    "humidity": (
        "rh hum humidity feuchte luftfeuchte luftfeuchtigkeit humidite hr vocht luchtvochtigheid vochtigheid "
        "moisture relhum "
        "umidita humedad "
        "luftfuktighet fuktighet luftfugtighed fugtighed fukt fugt kosteus ilmankosteus",
        "feucht humid vocht umidit humedad fuktighet fugtighed kosteus",
    ),
    "price": (
        "price tariff preis prix tarif prijs tarief spot epex cost kosten strompreis dayahead "
        "prezzo precio tariffa tarifa "
        "pris elpris strompris spotpris hinta sahkonhinta",
        "preis price tarif prezzo precio tariff elpris strompris spotpris hinta",
    ),
    "other": (
        "co2 voc tvoc pm ppm window fenster fenetre raam door tur tuer porte deur motion presence occupancy occ "
        "occupied bewegung praesenz battery batterie batterij accu rssi lqi linkquality light licht lux lumiere "
        "verlichting illuminance wind rain regen pluie neerslag precipitation pressure druck pression druk baro "
        "dew dewpoint taupunkt cloud clouds bewolking snow alarm fault error mode modus id uid uuid idx row "
        "record version uptime noise voltage spannung tension courant amps ampere contact kontakt vibration smoke "
        "enthalpy enth cfm airflow volumenstrom durchfluss debit flowrate lpm speedwind fridge freezer "
        "kuehlschrank gefrierschrank oven dryer washer tv computer nas server aquarium pool soil boden cpu cop "
        "efficiency filter serial seq sequence line year month day hour minute weekday holiday lat lon "
        "signalstrength staubsauger drucker phone motionsensor bewegungsmelder people persons personen starts "
        "hours betriebsstunden days license quality flags flag rev kitchenlights plug socket steckdose "
        "stopcontact prise "
        "finestra ventana porta puerta luce luz vento viento pioggia lluvia pressione presion batteria bateria "
        "fonster vindu vindue ikkuna dorr ovi lys ljus valo tuuli nederbord nedbor luftryck lufttrykk lufttryk "
        "ilmanpaine "
        "batteri paristo rorelse bevaegelse bevegelse liike",
        "fenster bewegung batter humidex pressure steckdose kuehlschr kuhlschr gefrier luftdruck taupunkt "
        "dewpoint illumin linkqual windspeed betriebsstund durchfluss volumenstr occupan "
        "finestra ventana fonster vindue ikkuna batteri luftryck lufttryk ilmanpain",
    ),
}
_WHOLE = {tag: frozenset(whole.split()) for tag, (whole, _) in _WORDS.items()}
_PARTS = {tag: tuple(parts.split()) for tag, (_, parts) in _WORDS.items()}
# Tags of two words that follow one another.
_PAIRS = {
    "hotwater": "hot water", "eauchaude": "hot water", "domesticwater": "hot water", "warmwater": "hot water",
    "drybulb": "outdoor", "setpoint": "setpoint", "setpt": "setpoint", "heatpump": "heating machine",
    "outsideair": "outdoor", "outdoorair": "outdoor", "supplyair": "supply", "returnair": "return",
    "bt1": "outdoor", "bt50": "room", "bt2": "supply", "bt3": "return", "bt6": "hot water", "bt7": "hot water",
    "lamminvesi": "hot water", "linkquality": "other", "dewpoint": "other",
    "spacetemp": "room", "feedin": "pv", "warmtepomp": "heating machine",
}  # fmt: skip
# The heat in the name of a machine is no heat that is measured.
_HEAT_PUMP = re.compile(r"(?<![a-z])(pomp[ae]|bomba)[ _-]*(a|di|de)[ _-]*(chaleur|calore?)(?![a-z])")
# Letters that are no other one with an accent.
_LETTERS = str.maketrans({"ß": "ss", "ø": "o", "æ": "ae", "œ": "oe", "đ": "d", "ł": "l"})
# Words that say nothing of where a signal is.
_GENERAL = frozenset(
    (
        *("sensor", "binary", "climate", "switch", "number", "input", "state", "value", "wert", "valeur", "waarde"),
        *("reading", "ist", "istwert", "actual", "current", "av", "ai", "ao", "bi", "bo", "bv", "pv", "act", "avg"),
        *("mean", "average", "trend", "log", "point", "data", "present", "analog", "device", "temp", "celsius"),
        *("fahrenheit", "the", "of", "de", "la", "le", "les", "des", "du", "d", "l", "het", "een", "der", "die", "das"),
        *("deg", "c", "f", "k", "w", "kw", "pct", "in", "o"),
    )
)
_UNITS = {
    "°c": "°C", "degc": "°C", "deg c": "°C", "c": "°C", "celsius": "°C", "grad c": "°C", "°f": "°F", "degf": "°F",
    "deg f": "°F", "f": "°F", "fahrenheit": "°F", "k": "K", "kelvin": "K", "%": "%", "percent": "%", "pct": "%",
    "prozent": "%", "w": "W", "watt": "W", "kw": "kW", "mw": "MW", "btu/h": "BTU/h", "wh": "Wh", "kwh": "kWh",
    "mwh": "MWh", "j": "J", "kj": "kJ", "mj": "MJ", "gj": "GJ", "btu": "BTU", "kbtu": "kBTU", "mmbtu": "MMBTU",
    "therm": "therm", "therms": "therm", "kcal": "kcal", "kbtu/h": "kBTU/h", "kbtu/hr": "kBTU/h", "btu/hr": "BTU/h",
    "kbtuh": "kBTU/h", "btuh": "BTU/h", "mbh": "kBTU/h", "mmbtu/h": "MMBTU/h", "kj/h": "kJ/h", "mj/h": "MJ/h",
    "kcal/h": "kcal/h", "ton": "ton", "tons": "ton", "sec": "s", "s": "s", "seconds": "s", "rps": "rps", "rpm": "rpm",
    "u/min": "rpm", "w/m²": "W/m²", "w/m2": "W/m²", "w m-2": "W/m²",
    "w/m^2": "W/m²",
    "kw/m²": "kW/m²", "kw/m2": "kW/m²", "hz": "Hz", "ppm": "ppm", "hpa": "hPa", "pa": "Pa", "lx": "lx", "v": "V",
    "a": "A", "l/h": "l/h", "m³": "m³", "m3": "m³", "m³/h": "m³/h", "cfm": "cfm", "m/s": "m/s", "km/h": "km/h",
    "eur/kwh": "per kWh", "€/kwh": "per kWh", "ct/kwh": "cent per kWh", "cent/kwh": "cent per kWh",
    "eur/mwh": "per MWh", "€/mwh": "per MWh", "usd/kwh": "per kWh", "$/kwh": "per kWh", "°": "°C", "deg": "°C",
}  # fmt: skip
# Units at the end of a name, behind a space or underscore.
_AT_END = (
    "degc", "degf", "celsius", "fahrenheit", "kwh", "wh", "mwh", "kw", "w", "pct", "percent", "c", "f", "k", "btu", "%",
    "°c", "°f", "kbtu", "mmbtu", "therms", "mbh", "kbtuh", "btuh", "gj", "mj", "kj", "kcal",
)  # fmt: skip


def _of_brackets(match: re.Match[str]) -> str:
    told = match[1].strip()
    says = re.search(r"[^\W\d_]{4}", told) and told.lower() not in _UNITS and "S/N" not in told
    return f" {told} " if says else " "


@lru_cache(maxsize=100_000)
def words_of(name: str) -> tuple[str, ...]:
    """The words of a name in lower case without accents; numbers stand apart, units in brackets are left out.

    What else stands in brackets counts where it has a word of four letters; of a logger's sensor (HOBO) its label does.
    """
    plain = re.sub(r"[\[(](?:[^\])]*LBL: ?)?([^\])]*)[\])]", _of_brackets, name)
    plain = re.sub(r"(?<![A-Za-z])([kM]?)(Wh|W|J)(?![a-z])", lambda m: m[0].lower(), plain)
    plain = re.sub(r"deg ?([CFK])(?![a-z])|[\b_]([CFK])$", " ", plain)
    plain = re.sub(r"(?<=[a-zà-ÿ])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z]{2})", " ", plain)
    folded = "".join(c for c in unicodedata.normalize("NFKD", plain.lower()) if not unicodedata.combining(c))
    folded = _HEAT_PUMP.sub(" heatpump ", folded.translate(_LETTERS))
    return tuple(re.findall(r"co2|[a-z]+|\d+", folded))


def unit_of(name: str) -> str:
    """The unit that a name tells, such as '°F' of 'ZN-T (deg F)'; '' where it tells none."""
    # In brackets behind a unit stands which one of several: the phase A, or the sensor.
    load = re.search(r"\b([kM]?Wh?)\s*[\[(]\w{1,3}[\])]$", name.strip())
    if load:
        return load[1]
    for told in re.findall(r"[\[(]([^\])]*)[\])]", name):
        if (unit := _UNITS.get(told.strip().lower())) is not None:
            return unit
        if price := re.fullmatch(r"(?i)(?:(ct|cents?|c|öre|øre|p|pence)|\w{2,4}|[€$£])/([kM]Wh)", told.strip()):
            return f"{'cent ' if price[1] else ''}per {'kWh' if price[2].lower() == 'kwh' else 'MWh'}"
    if re.search(r"(?i)w[/_ ]?m-?\^?[²2]", name):
        return "W/m²"
    if match := re.search(r"(?:[ _\-/]|\bin )(%|°[CF]|[A-Za-z]+)$", name.strip()):
        told = match[1].lower()
        if told in _AT_END and (len(told) > 1 or told == "%" or match[1].isupper() or "_" in name):
            return _UNITS[told]
    return ""


@lru_cache(maxsize=100_000)
def tags(name: str) -> frozenset[str]:
    """What the words of a name say of its signal."""
    words = words_of(name)
    found = {tag for tag, whole in _WHOLE.items() if not whole.isdisjoint(words)}
    for word in words:
        if len(word) > 4:
            found |= {tag for tag, parts in _PARTS.items() if any(part in word for part in parts)}
    if any(len(word) > 3 and word.endswith(("sp", "stpt")) for word in words):  # as EFFSP
        found.add("setpoint")
    pairs = {a + b for a, b in pairwise(words)}
    # T_a and T_i are Ta and Ti.
    of_two = {pair for pair in pairs if len(pair) == 2}
    found |= {tag for tag in ("outdoor", "room", "temperature", "heat", "sun") if not of_two.isdisjoint(_WHOLE[tag])}
    return frozenset(found | {tag for pair, tag in _PAIRS.items() if pair in pairs})


def place_of(name: str) -> frozenset[str]:
    """The words of a name that say where or of what its signal is: those without a tag, and names of rooms."""
    words = [word for word in words_of(name) if word not in _GENERAL]
    kept = [
        word
        for word in words
        if word.isdigit()
        or word
        in _WHOLE["room"] - {"t", "ti", "in", "int", "znt", "spt", "rmt", "zn", "zone", "room", "space", "rm", "raum"}
        or (len(word) > 4 and any(part in word for part in _PARTS["room"]))
        or (
            not any(word in whole for whole in _WHOLE.values())
            and not (len(word) > 4 and any(part in word for parts in _PARTS.values() for part in parts))
        )
    ]
    return frozenset(
        re.sub(r"(temperat\w*|temp|ventil\w*|soll\w*|ist\w*|feucht\w*)$", "", word) or word for word in kept
    )
