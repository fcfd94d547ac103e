{% from "head.ls" import head %}
{% macro six(names, unit, numbers) %}
{% for number in numbers %}{{ "\t" if loop.index0 % 3 == 0 else "\t" }}{{ names[loop.index0] }}{% if names[0] == "X" %} {% endif %}={{ number|listed }}{% if names[0] == "X" and loop.index0 < 3 %}  mm{% else %} deg{% endif %}{{ "" if loop.last else "," }}{{ "\n" if loop.index0 == 2 else "" }}{% endfor %}
{% endmacro %}
{% macro axes(number, angles) %}
P[{{ number }}]{
   GP1:
	UF : 9, UT : 10,	
{{ six(["J1", "J2", "J3", "J4", "J5", "J6"], "deg", angles) }}
};
{% endmacro %}
{% macro pose(number, config, numbers) %}
P[{{ number }}]{
   GP1:
	UF : 9, UT : 10,		CONFIG : '{{ config }}',
{{ six(["X", "Y", "Z", "W", "P", "R"], "mm", numbers) }}
};
{% endmacro %}
{{ head(name, plan.made) -}}
   0:  !plan {{ plan.hash }} ;
   0:  !ball, its centre, bar, stroke ;
   0:  !DBBBALL {{ ball }} ;
{% for part in centre[:3] %}
   0:  !DBBCEN {{ part|mm }} ;
{% endfor %}
   0:  !DBBLEN {{ plan.bar.length_mm|mm }} ;
   0:  !DBBLOW {{ plan.bar.stroke_mm[0]|mm }} ;
   0:  !DBBHIGH {{ plan.bar.stroke_mm[1]|mm }} ;
{% if plan.sync == "output" %}
   0:  !DBBSTB {{ plan.outputs.strobe }} ;
{% endif %}
   0:  !tool ball and base frame ;
   0:  PR[100]=P[1]    ;
   0:  UTOOL[10]=PR[100] ;
   0:  PR[100]=P[2]    ;
   0:  UFRAME[9]=PR[100] ;
   0:  UFRAME_NUM=9 ;
   0:  UTOOL_NUM=10 ;
{% if plan.sync == "output" %}
   0:  DO[{{ plan.outputs.strobe }}]=OFF ;
   0:  GO[1]=0 ;
{% endif %}
   0:J P[3] {{ start_percent|percent }}% FINE    ;
{% if stays %}
   0:  !the bar stays on ball {{ ball }} ;
{% else %}
   0:  MESSAGE[bar on ball {{ ball }}: start] ;
   0:  PAUSE ;
{% endif %}
{% if plan.sync == "output" %}
{% for pulse in range(3) %}
   0:  DO[{{ plan.outputs.strobe }}]=PULSE,0.2sec ;
   0:  WAIT   0.60(sec) ;
{% endfor %}
{% endif %}
{% for step in steps %}
   0:  !row {{ step.index }}, {{ step.kind }} ;
{% set point = points[step.row - 1] %}
{% set ms = (step.duration_s * 1000)|percent|int %}
{% set time %}{% if ms >= 1 and ms <= 32000 %}{{ ms }}msec{% elif ms > 32000 %}{{ step.duration_s|tenths }}sec{% elif step.motion == "ptp" %}{{ step.axis_percent|percent }}%{% else %}{{ point.feed_mm_s|ceiling }}mm/sec{% endif %}{% endset %}
{% set end = "FINE" if step.rests else "CNT0" %}
{% if step.motion == "ptp" %}
   0:J P[{{ step.row + 3 }}] {{ time }} {{ end }}    ;
{% elif step.through %}
   0:C P[{{ step.through + 3 }}]    
    :  P[{{ step.row + 3 }}] {{ time }} {{ end }}    ;
{% else %}
   0:L P[{{ step.row + 3 }}] {{ time }} {{ end }}    ;
{% endif %}
{% if step.number %}
   0:  WAIT {{ plan.settle_s|hundredths }}(sec) ;
{% if plan.sync == "output" %}
   0:  GO[1]={{ step.number }} ;
   0:  DO[{{ plan.outputs.strobe }}]=ON ;
   0:  WAIT {{ step.dwell_s|hundredths }}(sec) ;
   0:  DO[{{ plan.outputs.strobe }}]=OFF ;
{% else %}
   0:  WAIT {{ step.dwell_s|hundredths }}(sec) ;
{% endif %}
   0:  WAIT   0.10(sec) ;
{% endif %}
{% if plan.sync == "output" and step.row == end_mark %}
{% for pulse in range(2) %}
   0:  DO[{{ plan.outputs.strobe }}]=PULSE,0.2sec ;
   0:  WAIT   0.60(sec) ;
{% endfor %}
{% endif %}
{% endfor %}
/POS
{{ pose(1, "N U T, 0, 0, 0", plan.tool) -}}
{{ pose(2, "N U T, 0, 0, 0", plan.base) -}}
{{ axes(3, start_deg) -}}
{% for point in points %}
{% if point.config %}
{{ pose(loop.index + 3, point.config, point.pose) -}}
{% else %}
{{ axes(loop.index + 3, point.axes) -}}
{% endif %}
{% endfor %}
/END
