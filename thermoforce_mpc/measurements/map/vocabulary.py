"""Words in names of signals, in ten languages of Europe; abbreviations of building automation and of heat pumps.

Abbreviations are those of ASHRAE's and Project Haystack's point lists (OA-T, ZN-T, SAT, VLV), grey-box models write Ti,
Ta, Ph and Ps (Bacher and Madsen 2011, doi 10.1016/j.enbuild.2011.02.005); BT1, BT50 and the like are NIBE's sensors.
"""

from __future__ import annotations

WORDS: dict[str, tuple[str, str]] = {
    "outdoor": (
        "out outdoor outdoors outside oa oat oda osa osat ambient amb ext exterior external extern exterieur "
        "exterieure aussen aussenluft ta te tout toa tamb text tex tdb drybulb weather wetter meteo weer buiten "
        "oataverage toutdoor outdoortemp tdrybul at dehors gevel "
        "esterno esterna esterni fuori exteriores externa afuera "
        "zewnetrzna zewnetrzne zewn zewnatrz venkovni venku "
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
        "pokoj sypialnia lazienka kuchnia wewnetrzna biuro korytarz obyvak loznice koupelna kuchyne mistnost vnitrni "
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
        "temperatura teplota "
        "lampotila",
        "temperat temp lampotil teplot",
    ),
    "setpoint": (
        "sp stp setp set setting settings setpoint setpt stpt target targ soll sollwert solltemp consigne cons "
        "ingesteld gewenst streefwaarde setpunt instelling desired wunsch csp hsp clgsp htgsp htsp clsp zsp tset "
        "thset tcset tsp tsoll wunschtemperatur doel gewuenscht vorgabe occclgsp occhtgsp eff sptrn sollt gewenste "
        "ingestelde impostata impostato consigna deseada deseado objetivo desiderata desiderato "
        "zadana zadany nastawa pozadovana nastavena "
        "borvarde onskad onsket indstillet innstilt installd asetus asetusarvo tavoite haluttu settpunkt saetpunkt",
        "setpoint sollwert solltemp consigne streef instelwaarde wunschtemp settemp targettemp tempset vorgabe "
        "gewenst ingesteld "
        "impostat consigna desider borvarde onskad "
        "onsket asetusarv tavoit settpunkt saetpunkt",
    ),
    "lower": (
        "lower min minimum tmin unten untere minima minimo inferiore inferior",
        "lower minimal",
    ),
    "upper": (
        "upper max maximum tmax obere massima massimo superiore superior maxima maximo",
        "upper maximal",
    ),
    "supply": (
        "supply sup sat sa dat da flow vorlauf vl depart aller aanvoer lwt hws chws leaving discharge zuluft "
        "inlet tsup tvl flowtemp soufflage inblaas pulsion "
        "mandata impulsion zasilanie zasilania privod privodni "
        "framledning fremlob fremlop turledning menovesi meno tilluft",
        "vorlauf aanvoer supply zuluft discharge soufflage pulsion flowtemp mandata impulsion framledning fremlob "
        "fremlop turledn menoves tilluft",
    ),
    "return": (
        "return ret retour rat ra rl rucklauf ruecklauf hwr chwr ewt entering abluft tret trl returntemp reprise "
        "ritorno retorno powrot powrotu vratna zpatecka "
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
        "acs acquacalda aguacaliente sanitaria cwu tuv "
        "varmvatten varmtvann varmtvand brugsvand tappevann tappvarmvatten kayttovesi lamminvesi vvb lkv",
        "warmwasser brauchwasser trinkwasser tapwater warmwater hotwater warmtapwater eauchaude varmvatten "
        "varmtvann varmtvand brugsvand kayttoves lamminves",
    ),
    "valve": (
        "valve vlv vp yh yk yv ventil stellventil stellung stellwert stellgrosse stellgroesse stellsignal stellantrieb "
        "vanne klep klepstand afsluiter trv opening ouverture oeffnung offnung hv rv htgvlv clgvlv reheat rhv "
        "rhvlv ventilstellung ventilposition vannenposition servo actuator aktor vlvo "
        "valvola valvula apertura zawor zaworu "
        "venttiili venttiilin shunt",
        "ventil valve vanne klepst stellwert stellgr stellsig stellantr valvol valvul venttiil",
    ),
    "level": (
        "u level pct modulation modul mod modulating stage stufe demand cmd command co lvl duty speed drehzahl freq "
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
        "potenza potencia moc mocy prikon "
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
        "cool cooling clg csp clgsp clsp tcset occclgsp "
        "chw kuhlung kuehlung kuehlen kuhlen kuhl kalte kaelte froid climatisation clim koeling "
        "koel airco ac chiller klima clgvlv "
        "raffrescamento raffreddamento refrigeracion freddo climatizzatore "
        "kyla kylning koling kjoling jaahdytys",
        "kuhl kuehl koel froid climatis kaelte raffre refriger jaahdyt kjoling",
    ),
    "sun": (
        "sun solar glob irradiance irrad irradiation ghi glohor hglohor global radiation globalstrahlung strahlung "
        "einstrahlung sonne rayonnement ensoleillement straling zonnestraling instraling pyranometer pyrano ps "
        "isol igh solrad solradiation solarradiation shortwave poa isolation glorad zon soleil is sol gsol hsol "
        "radiazione radiacion irraggiamento solare irradiancia irradianza naslonecznienie promieniowanie "
        "slunecni zareni "
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
        "umidita humedad wilgotnosc vlhkost "
        "luftfuktighet fuktighet luftfugtighed fugtighed fukt fugt kosteus ilmankosteus",
        "feucht humid vocht umidit humedad fuktighet fugtighed kosteus wilgotn vlhkost",
    ),
    "price": (
        "price tariff preis prix tarif prijs tarief spot epex cost kosten strompreis dayahead "
        "prezzo precio tariffa tarifa cena taryfa "
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
        "stopcontact prise vpd "
        "okno okna drzwi dvere swiatlo svetlo "
        "finestra ventana porta puerta luce luz vento viento pioggia lluvia pressione presion batteria bateria "
        "fonster vindu vindue ikkuna dorr ovi lys ljus valo tuuli nederbord nedbor luftryck lufttrykk lufttryk "
        "ilmanpaine "
        "batteri paristo rorelse bevaegelse bevegelse liike",
        "fenster bewegung batter humidex pressure steckdose kuehlschr kuhlschr gefrier luftdruck taupunkt "
        "dewpoint illumin linkqual windspeed betriebsstund durchfluss volumenstr occupan "
        "finestra ventana fonster vindue ikkuna batteri luftryck lufttryk ilmanpain",
    ),
}
"""By tag: whole words, and beginnings, ends or parts of compound words of five letters and more."""
PAIRS = {
    "hotwater": "hot water", "eauchaude": "hot water", "domesticwater": "hot water", "warmwater": "hot water",
    "drybulb": "outdoor", "setpoint": "setpoint", "setpt": "setpoint", "heatpump": "heating machine",
    "outsideair": "outdoor", "outdoorair": "outdoor", "supplyair": "supply", "returnair": "return",
    "bt1": "outdoor", "bt50": "room", "bt2": "supply", "bt3": "return", "bt6": "hot water", "bt7": "hot water",
    "lamminvesi": "hot water", "linkquality": "other", "dewpoint": "other",
    "heatingrate": "heat", "heatingenergy": "heat",  # of EnergyPlus, whatever gives it
    "pompaciepla": "heating machine", "pompyciepla": "heating machine", "tepelnecerpadlo": "heating machine",
    "spacetemp": "room", "feedin": "pv", "warmtepomp": "heating machine",
}  # fmt: skip
"""Tags of two words that follow one another."""
GENERAL = frozenset(
    (
        *("sensor", "binary", "climate", "switch", "number", "input", "state", "value", "wert", "valeur", "waarde"),
        *(
            "reading",
            "measure",
            "ist",
            "istwert",
            "actual",
            "current",
            "av",
            "ai",
            "ao",
            "bi",
            "bo",
            "bv",
            "pv",
            "act",
            "avg",
        ),
        *("mean", "average", "trend", "log", "point", "data", "present", "analog", "device", "temp", "celsius"),
        *("fahrenheit", "the", "of", "de", "la", "le", "les", "des", "du", "d", "l", "het", "een", "der", "die", "das"),
        *("deg", "c", "f", "k", "w", "kw", "pct", "in", "o", "air", "rate", "low", "high", "therm"),
    )
)
"""Words that say nothing of where a signal is."""
