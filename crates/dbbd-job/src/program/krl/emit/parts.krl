{# What the files of a program share: heads, the identity of the plan, structures. -#}
{% macro head() -%}
&ACCESS RVP
&REL 1
&PARAM EDITMASK = *
&PARAM TEMPLATE = C:\KRC\Roboter\Template\vorgabe
{% endmacro -%}
{% macro made(lines) -%}
{% for line in lines %}
{{ line }}
{% endfor %}
{% endmacro -%}
{% macro ini() -%}
;FOLD INI;%{PE}
;FOLD BASISTECH INI
GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )
INTERRUPT ON 3
BAS (#INITMOV,0 )
;ENDFOLD (BASISTECH INI)
;FOLD USER INI
;Make your modifications here
;ENDFOLD (USER INI)
;ENDFOLD (INI)
{% endmacro -%}
{% macro external(plan) -%}
{% if plan.krc2 %}
;FOLD EXTERNAL DECLARATIONS;%{PE}%MKUKATPBASIS,%CEXT,%VCOMMON,%P
;FOLD BASISTECH EXT;%{PE}%MKUKATPBASIS,%CEXT,%VEXT,%P
EXT BAS (BAS_COMMAND :IN,REAL :IN )
DECL INT SUCCESS
;ENDFOLD (BASISTECH EXT)
;ENDFOLD (EXTERNAL DECLARATIONS)
{% endif %}
{% endmacro -%}
{% macro identity(plan) -%}
; ball-bar calibration, plan {{ plan.hash }}, robot {{ plan.robot }}
DECL CHAR DBBPLAN[{{ [plan.hash|length, 1]|max }}]
DBBPLAN[]="{{ plan.hash }}"
DECL CHAR DBBROBOT[{{ [plan.robot|length, 1]|max }}]
DBBROBOT[]="{{ plan.robot }}"
{% endmacro -%}
{# Six numbers without the bracket that closes them. -#}
{% macro pose(p) %}{X {{ p[0]|mm }},Y {{ p[1]|mm }},Z {{ p[2]|mm }},A {{ p[3]|deg }},B {{ p[4]|deg }},C {{ p[5]|deg }}{% endmacro -%}
{# External axes, which this robot does not have: components that are missing are taken from the point before. -#}
{% macro external_axes() %},E1 0.0,E2 0.0,E3 0.0,E4 0.0,E5 0.0,E6 0.0}{% endmacro -%}
